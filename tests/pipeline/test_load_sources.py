"""What corrects an estimator of the load: where and when, as ned sees it from the hook."""

import math
from dataclasses import replace

import pytest

from swingd.core.gp_ekf import Source
from swingd.core.status import Status
from swingd.estimation.base import LoadMeasurement
from swingd.model.events import Attitude, LoadSighting, LocalPosition, SightingFrame, Vec3
from swingd.model.parameters import Camera, Parameters
from swingd.pipeline.load_sources import REMEMBERED, CameraState, LoadSources

DELAY_S = 0.08
BODY, NED = SightingFrame.BODY_FRD, SightingFrame.LOCAL_NED


class Listener:
    """Notes what it is corrected by."""

    def __init__(self) -> None:
        self.measurements: list[LoadMeasurement] = []
        self.turned: list[float] = []
        self.answer = Status.OK

    def correct(self, measurement: LoadMeasurement) -> Status:
        self.measurements.append(measurement)
        return self.answer

    def turn(self, yaw_jump_rad: float) -> None:
        self.turned.append(yaw_jump_rad)

    def stand(self, t_boot_s: float, to_ned_rad: float) -> None:
        self.stood = (t_boot_s, to_ned_rad)

    def of(self, source: Source) -> list[LoadMeasurement]:
        return [one for one in self.measurements if one.source is source]


class Bench:
    """Sources with a vehicle that stands, attitudes and positions at 50 Hz."""

    def __init__(self, hook_frd_m: Vec3 = (0.0, 0.0, 0.0), **camera: object) -> None:
        parameters = Parameters()
        parameters = replace(
            parameters,
            vehicle=replace(parameters.vehicle, hook_frd_m=hook_frd_m),
            camera=Camera(source="landing_target", delay_s=DELAY_S, **camera),  # type: ignore[arg-type]
        )
        self.listener = Listener()
        self.sources = LoadSources(parameters, self.listener)  # type: ignore[arg-type]
        self.t_s = 10.0

    def run(
        self, duration_s: float = 0.5, roll: float = 0.0, pitch: float = 0.0, yaw: float = 0.0,
        yaw_rate: float = 0.0, pos: Vec3 = (0.0, 0.0, -8.0), vel: Vec3 = (0.0, 0.0, 0.0),
    ) -> "Bench":  # fmt: skip
        for step in range(round(duration_s / 0.02)):
            self.t_s += 0.02
            turned = math.remainder(yaw + 0.02 * step * yaw_rate, 2.0 * math.pi)
            self.sources.add_attitude(Attitude(self.t_s, self.t_s, roll, pitch, turned))
            north, east, down = (p + 0.02 * step * v for p, v in zip(pos, vel, strict=True))
            self.sources.add_position(LocalPosition(self.t_s, self.t_s, (north, east, down), vel))
        return self

    def see(self, position: Vec3, frame: SightingFrame = BODY, age_s: float = 0.0) -> LoadMeasurement | None:
        before = len(self.listener.measurements)
        self.sources.add_sighting(LoadSighting(self.t_s, self.t_s - age_s, position, frame))
        return self.listener.measurements[-1] if len(self.listener.measurements) > before else None


def test_a_load_ahead_of_a_vehicle_that_heads_east_is_east_of_it() -> None:
    """The measurement is the vehicle from the load: west of it and above."""
    seen = Bench().run(yaw=math.pi / 2).see((0.5, 0.0, 1.4))
    assert seen is not None
    assert seen.source is Source.REL_POS
    assert seen.value == pytest.approx((0.0, -0.5, -1.4), abs=1e-9)
    distance = math.hypot(0.5, 1.4)
    assert seen.std == pytest.approx((0.03 + 0.02 * distance,) * 3)


def test_the_attitude_is_that_of_the_picture_and_not_of_its_arrival() -> None:
    """The vehicle turns by 1 rad/s; the picture is 0.08 s old when its message is the quickest."""
    bench = Bench().run(1.0, yaw_rate=1.0)
    seen = bench.see((1.0, 0.0, 1.0), age_s=0.03)
    assert seen is not None
    heading = 0.98 - DELAY_S - 0.03
    assert seen.t_s == pytest.approx(bench.t_s - DELAY_S - 0.03)
    assert math.atan2(-seen.value[1], -seen.value[0]) == pytest.approx(heading, abs=1e-6)


def test_a_heading_that_passes_south_is_interpolated_the_short_way() -> None:
    bench = Bench().run(1.0, yaw=math.pi - 0.89, yaw_rate=1.0)
    seen = bench.see((1.0, 0.0, 1.0))
    assert seen is not None
    heading = math.pi - 0.89 + 0.98 - DELAY_S
    assert math.remainder(math.atan2(-seen.value[1], -seen.value[0]) - heading, 2 * math.pi) == pytest.approx(0.0)


def test_camera_and_hook_are_where_they_are() -> None:
    """A camera 0.2 m ahead of the centre, a hook 0.1 m below it: the load is 0.2 m ahead of the hook."""
    bench = Bench(hook_frd_m=(0.0, 0.0, 0.1), position_frd_m=(0.2, 0.0, 0.0)).run()
    seen = bench.see((0.0, 0.0, 1.5))
    assert seen is not None
    assert seen.value == pytest.approx((-0.2, 0.0, -1.4))


def test_an_absolute_place_counts_from_where_the_vehicle_was() -> None:
    bench = Bench(hook_frd_m=(0.0, 0.0, 0.1)).run(1.0, pos=(50.0, 20.0, -8.0), vel=(2.0, 0.0, 0.0))
    vehicle_north = 50.0 + 2.0 * (0.98 - DELAY_S)
    seen = bench.see((vehicle_north - 0.3, 20.1, -6.5), NED)
    assert seen is not None
    assert seen.value == pytest.approx((0.3, -0.1, -1.4), abs=1e-6)


def test_a_picture_of_a_time_that_nothing_is_known_of_is_counted() -> None:
    bench = Bench()
    assert bench.see((0.0, 0.0, 1.5)) is None
    bench.run(2.0)
    assert bench.see((0.0, 0.0, 1.5), age_s=1.5) is None
    bench.t_s += 1.0
    assert bench.see((0.0, 0.0, 1.5)) is None
    camera = bench.sources.camera(bench.t_s)
    assert camera is not None
    assert camera.unused == 3
    bench.sources.reset()
    assert bench.see((0.0, 0.0, 1.5), NED) is None


@pytest.mark.parametrize("answer", [Status.GATED, Status.TOO_LATE, Status.NOT_CONVERGED])
def test_a_picture_that_the_filter_does_not_take_is_counted(answer: Status) -> None:
    bench = Bench().run()
    bench.listener.answer = answer
    bench.see((0.0, 0.0, 1.5))
    camera = bench.sources.camera(bench.t_s)
    assert camera is not None
    assert camera.unused == 1


def test_positions_are_of_the_hook_and_no_more_often_than_they_say_something() -> None:
    bench = Bench()
    bench.sources.stand(10.0, 0.3, (0.0, 0.1, 0.2), (0.4, 0.0, 0.0))
    assert bench.listener.stood == (10.0, 0.3)
    bench.run(1.0, vel=(1.0, 0.0, 0.0))
    positions, velocities = bench.listener.of(Source.VEHICLE_POS), bench.listener.of(Source.VEHICLE_VEL)
    assert len(positions) == len(velocities) == 25
    assert positions[-1].value == pytest.approx((0.96, 0.1, -7.8))
    assert velocities[-1].value == pytest.approx((1.4, 0.0, 0.0))
    # As uncertain as 25 of them a second may be, so that a slower stream says as much.
    assert positions[-1].std == pytest.approx((0.02 * 5.0,) * 3)


def test_a_reset_of_the_yaw_turns_the_filter_and_forgets_the_attitudes_before() -> None:
    bench = Bench().run(0.5)
    bench.sources.turn(0.0)
    assert bench.listener.turned == []
    assert bench.see((0.0, 0.0, 1.5)) is not None
    bench.sources.turn(0.4)
    assert bench.listener.turned == [0.4]
    assert bench.see((0.0, 0.0, 1.5)) is None


def test_streams_without_end_do_not_fill_the_memory() -> None:
    bench = Bench()
    for number in range(3 * REMEMBERED):
        bench.sources.add_attitude(Attitude(0.0, 10.0 + 1e-5 * number, 0.0, 0.0, 0.0))
    assert len(bench.sources._attitudes) <= REMEMBERED


def test_the_camera_has_a_rate_and_an_age() -> None:
    bench = Bench().run(1.0)
    assert bench.sources.camera(bench.t_s) == CameraState(0.0, None, 0)
    for _ in range(30):
        bench.run(0.06)
        bench.see((0.0, 0.0, 1.5))
    camera = bench.sources.camera(bench.t_s + 0.1)
    assert camera is not None
    assert camera.got_hz == pytest.approx(15.0, abs=1.0)
    assert camera.age_s == pytest.approx(0.1)
    parameters = Parameters()
    assert LoadSources(parameters, Listener()).camera(bench.t_s) is None  # type: ignore[arg-type]
