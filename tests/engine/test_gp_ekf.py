"""The GP-EKF in flight: with and without a camera, with what was learned of a parcel's drag, recorded and replayed."""

import json
import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from pymavlink.dialects.v20 import common as mavlink
from typer.testing import CliRunner

import swingd
from swingd.cli.main import app
from swingd.config.gp_model import one_line
from swingd.config.loader import parameters_from_json
from swingd.config.plain import parameters_to_json
from swingd.estimation import GpSwing
from swingd.estimation.gp_ekf import LoadEstimate
from swingd.link.stamps import Drop
from swingd.model.actions import Action, Health, SwingReport
from swingd.model.estimate import ResetReason
from swingd.model.parameters import Camera, Estimator, Mode, Parameters, Path, Waypoint
from swingd.pipeline.path import PathState
from swingd.record.event_log import EventLogWriter
from swingd.replay import replay
from swingd.sim.faults import parse_fault
from swingd.sim.plant import rotation_matrix
from swingd.sim.truth import COLUMNS, truth_row

from .flight import Flight, FloatArray, errors_m, hold, state

CAMERA_HZ = 15.0
PARCEL_M2 = 0.05
"""Drag coefficient times area of a box of 20 cm."""
DRAG_N_PER_MPS = 0.35
"""Of the vehicle, which the filters are not told of."""
TRAINING = ((3.0, 0.0), (0.0, 2.0), (-2.5, 1.0), (1.0, -3.0), (0.0, 0.0), (-1.5, -1.5), (3.5, 1.5), (-3.0, 0.5),
            (0.5, 3.5), (1.5, -2.0), (-2.0, -3.0), (0.0, 0.0))  # fmt: skip
"""Velocities, north and east, 3 s each."""
ZIGZAG = (Waypoint(10.0, 2.0), Waypoint(12.0, 10.0), Waypoint(2.0, 14.0))
DROPOUT = {"camera_dropout_share": 0.0}


def seen(parameters: Parameters, camera: bool = True, model: str = "", **simulation: object) -> Parameters:
    """On the GP-EKF, with a camera or without."""
    return replace(
        parameters,
        estimator=Estimator(name="gp-ekf"),
        gp_ekf=replace(parameters.gp_ekf, model="model.json" if model else "none", model_text=model),
        camera=Camera(source="landing_target") if camera else Camera(),
        simulation=replace(
            parameters.simulation,
            camera_hz=CAMERA_HZ if camera else 0.0,
            **simulation,  # type: ignore[arg-type]
        ),
    )


def dragged(parameters: Parameters) -> Parameters:
    """The same with a drag of the vehicle."""
    return replace(parameters, vehicle=replace(parameters.vehicle, drag_n_per_mps=DRAG_N_PER_MPS))


class Watch:
    """Notes what the filter knows of the load at every step."""

    def __init__(self, flight: Flight) -> None:
        self.flight = flight
        self.known: list[LoadEstimate] = []
        self.pictures: list[tuple[float, FloatArray]] = []
        see, sighting = flight._see, flight.engine.adapter.sighting

        def noted(t_s: float, action: Action) -> None:
            see(t_s, action)
            estimator = flight.engine.pipeline._estimator
            if isinstance(action, SwingReport) and isinstance(estimator, GpSwing) and estimator.load is not None:
                self.known.append(estimator.load)

        def shown(t_s, frame):  # type: ignore[no-untyped-def]
            told = sighting(t_s, frame)
            if told is not None:
                rotation = np.array(rotation_matrix(*flight.peer.truth().ned_from_frd))
                self.pictures.append((flight.t_s, rotation @ np.array(told.position_m)))
            return told

        flight.engine._on_action = noted
        flight.engine.adapter.sighting = shown  # type: ignore[method-assign]

    def errors(self, begin_s: float) -> FloatArray:
        """(n, 2) of where the load is from the vehicle, from a time on [m].

        Where the vehicle is the autopilot says, and its error is the same whatever filter listens.
        """
        known = [one for one in self.known if one.t_s >= begin_s]
        rel, _ = self._truth(np.array([one.t_s for one in known]))
        return np.array([one.x[3:5] for one in known]) - rel

    def nees(self, begin_s: float) -> FloatArray:
        """(n,) of r and v, 4 degrees of freedom."""
        known = [one for one in self.known if one.t_s >= begin_s]
        rel, rel_vel = self._truth(np.array([one.t_s for one in known]))
        chosen = [3, 4, 8, 9]
        errors = np.array([one.x[chosen] for one in known]) - np.column_stack([rel, rel_vel])
        return np.array(
            [e @ np.linalg.solve(one.P[np.ix_(chosen, chosen)], e) for e, one in zip(errors, known, strict=True)]
        )

    def camera_errors(self, begin_s: float) -> FloatArray:
        """(n, 2) of r as the camera shows it, its last picture held [m]."""
        at = np.array([truth.t_boot_s for truth in self.flight.truths if truth.t_boot_s >= begin_s])
        rel, _ = self._truth(at)
        times = np.array([t_s for t_s, _ in self.pictures])
        last = np.searchsorted(times, at) - 1
        return np.array([-self.pictures[k][1][:2] for k in last]) - rel

    def _truth(self, at: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(n, 2) the vehicle relative to the load, and its derivative."""
        truths = self.flight.truths
        t = np.array([truth.t_boot_s for truth in truths])

        def along(values: list[tuple[float, ...]]) -> FloatArray:
            return np.column_stack([np.interp(at, t, column) for column in np.array(values).T])

        load, vehicle = along([x.load_pos_ned_m for x in truths]), along([x.pos_ned_m for x in truths])
        load_vel, vel = along([x.load_vel_ned_mps for x in truths]), along([x.vel_ned_mps for x in truths])
        return (vehicle - load)[:, :2], (vel - load_vel)[:, :2]


def rms(errors: FloatArray) -> float:
    return float(np.sqrt(np.mean(np.sum(errors**2, axis=1))))


def steps(flight: Flight) -> Flight:
    """Four metres a second ahead, three to the side, and stop."""
    flight.forget()
    for reference in ((4.0, 0.0, 0.0), (0.0, 3.0, 0.0), (0.0, 0.0, 0.0)):
        flight.reference = reference
        flight.run(5.0)
    return flight


@pytest.fixture(scope="module")
def hovering_seen() -> Flight:
    """In OFFBOARD on the GP-EKF with a camera, in calm air; only to be forked."""
    flight = Flight(seen(hold(), **DROPOUT)).take_off()
    return flight.run_until_healthy(8.0).enter_offboard().run(2.0)


@pytest.fixture
def hovering(hovering_seen: Flight) -> Callable[[], Flight]:
    return hovering_seen.fork


def test_it_damps_the_swing_without_a_camera() -> None:
    flight = Flight(seen(hold(), camera=False)).take_off()
    flight.run_until_healthy(8.0).enter_offboard().run(2.0)
    steps(flight)
    assert flight.rmse_deg() < 1.3
    assert np.degrees(flight.chi_rad(flight.t_s - 2.0, math.inf)).max() < 5.0
    assert sum(flight.engine.pipeline.resets.values()) == flight.engine.pipeline.resets[ResetReason.LIFT]


def test_in_wind_that_nobody_told_it_of_a_camera_makes_it_better_and_certain() -> None:
    """Gusts of 2 m/s on a drag that is not configured push the vehicle about in the pendulum's time.

    Without a camera nobody can tell them from the load, and the correction waits now and then; a camera sees that it is
    wind.
    """
    errors, doubts = [], []
    for camera in (False, True):
        believes = seen(hold(), camera, wind_ned_mps=(6.0, 0.0, 0.0), gust_std_mps=2.0)
        flight = Flight(dragged(believes), believes).take_off()
        flight.run(8.0).enter_offboard()
        errors.append(steps(flight).rmse_deg())
        doubts.append(any("measurements and model disagree" in text for _, text in flight.texts))
    without, with_camera = errors
    assert with_camera < 0.7 * without
    assert with_camera < 1.5
    assert doubts == [True, False]


def test_what_is_of_the_load_does_not_reach_the_autopilot_and_what_is_not_does(hovering: Callable[[], Flight]) -> None:
    """From an endpoint: the load is target 0, and a pad to land on is target 1. Another vehicle's load is its own."""
    flight = hovering()
    camera, ground = flight.connect(ids=(1, 101)), flight.connect(ids=(255, 190))
    other = flight.connect(ids=(2, 100))
    received: list[int] = []
    deliver = flight.peer.receive

    def noted(data: bytes) -> None:
        received.extend(
            frame.message.target_num
            for frame in Flight.splitter().receive(data)
            if frame.msg_id == mavlink.MAVLINK_MSG_ID_LANDING_TARGET
        )
        deliver(data)

    flight.peer.receive = noted  # type: ignore[method-assign]
    for number, (sender, target) in enumerate(((camera, 0), (camera, 1), (camera, 0), (camera, 1), (other, 0))):
        sender.send(
            mavlink.MAVLink_landing_target_message(
                1_000_000 + number,
                target,
                mavlink.MAV_FRAME_BODY_FRD,
                0,
                0,
                1.5,
                0,
                0,
                0.0,
                0.0,
                1.5,
                [1, 0, 0, 0],
                2,
                1,
            )
        )
        flight.run(0.05)
    assert received == [1, 1, 0]
    told = [text for _, text in flight.texts if text.startswith("LANDING_TARGET")]
    assert told == ["LANDING_TARGET of target 1 passes to the autopilot: the load is camera.target_num 0"]
    heard = [f.message.target_num for f in ground.heard() if f.msg_id == mavlink.MAVLINK_MSG_ID_LANDING_TARGET]
    assert heard.count(1) == 2
    assert heard.count(0) > 2, "who watches the link sees the load as well, and what the other camera says of it"
    assert flight.engine.adapter.drops[Drop.OTHER_SENDER] == 2


def test_a_camera_that_fails_is_missed_and_no_more(hovering: Callable[[], Flight]) -> None:
    flight = hovering()
    landing_target = mavlink.MAVLINK_MSG_ID_LANDING_TARGET
    flight.spoil = lambda _t_s, frames: [raw for raw in frames if raw[7] | raw[8] << 8 != landing_target]
    flight.run(1.0)
    steps(flight)
    camera = flight.engine.pipeline.camera(flight.t_s)
    assert camera is not None
    assert camera.got_hz == 0.0
    assert camera.age_s is not None
    assert camera.age_s > 10.0
    assert flight.rmse_deg() < 1.5
    assert flight.engine.pipeline.correcting
    flight.spoil = None
    flight.run(1.0)
    assert [text for _, text in flight.texts if "camera" in text] == [
        "the camera has not seen the load for 3 s",
        "the camera sees the load",
    ]


def test_pictures_of_something_else_are_not_believed_and_the_correction_waits(hovering: Callable[[], Flight]) -> None:
    """A camera that mistakes a thing 3 m aside for the load, for 5 s: who is wrong cannot be told."""
    flight = hovering()
    before, resets = flight.engine.pipeline.refusals["sighting"], dict(flight.engine.pipeline.resets)
    camera = flight.engine.adapter.sighting

    def mistaken(t_s, frame):  # type: ignore[no-untyped-def]
        told = camera(t_s, frame)
        return None if told is None else replace(told, position_m=(3.0, 0.0, 0.5))

    flight.engine.adapter.sighting = mistaken  # type: ignore[method-assign]
    flight.run(5.0)
    assert flight.engine.pipeline.refusals["sighting"] - before > 60
    assert flight.health is Health.DEGRADED
    assert not flight.engine.pipeline.correcting
    assert flight.engine.pipeline.resets == resets
    flight.engine.adapter.sighting = camera  # type: ignore[method-assign]
    flight.forget()
    flight.run(3.0)
    assert flight.rmse_deg() < 1.5
    assert flight.health is Health.ACTIVE


def test_a_heading_that_was_wrong_is_forgotten_when_the_autopilot_resets_it(hovering: Callable[[], Flight]) -> None:
    """Off by 0.3 rad for 4 s, in a manoeuvre: thrust is turned to a wrong north, and from then on to the right one."""
    flight = hovering()
    flight.peer.faults.inject(parse_fault("yaw 0.3 0..4").after(flight.peer.t_s))
    flight.reference = (3.0, 0.0, 0.0)
    flight.run(4.0)
    flight.forget()
    flight.reference = (0.0, 0.0, 0.0)
    flight.run(1.0)
    assert flight.rmse_deg() < 2.0
    steps(flight)
    assert flight.rmse_deg() < 1.3
    assert flight.engine.pipeline.correcting


def test_an_autopilot_that_restarts_is_followed_anew(hovering: Callable[[], Flight]) -> None:
    flight = hovering()
    flight.peer.reboot()
    flight.run(8.0)
    flight.take_off()
    flight.run_until_healthy(8.0)
    flight.forget()
    flight.run(3.0)
    assert flight.rmse_deg() < 2.0
    camera = flight.engine.pipeline.camera(flight.t_s)
    assert camera is not None
    assert camera.got_hz > 10.0


# ---- learning


@pytest.fixture(scope="module")
def learned(tmp_path_factory: pytest.TempPathFactory) -> str:
    """A model of the parcel, trained as a user does: fly, record, watch from outside, log, train."""
    folder = tmp_path_factory.mktemp("training")
    believes = seen(hold(), payload_drag_area_m2=PARCEL_M2)
    log = EventLogWriter(folder / "flight.swingd", swingd.__version__, parameters_to_json(believes))
    flight = Flight(dragged(believes), believes, log=log).take_off()
    flight.run_until_healthy(8.0).enter_offboard()
    for north, east in TRAINING:
        flight.reference = (north, east, 0.0)
        flight.run(3.0)
    log.close()
    with (folder / "truth.csv").open("w", encoding="utf-8") as file:
        file.write(",".join(COLUMNS) + "\n")
        file.writelines(",".join(map(repr, truth_row(truth))) + "\n" for truth in flight.truths[::2])
    for arguments in (
        ["gp", "log", "flight.swingd", "--truth", "truth.csv", "-o", "log.csv"],
        ["gp", "train", "log.csv", "--with-velocity", "-o", "model.json"],
    ):
        named = [str(folder / word) if "." in word else word for word in arguments]
        result = CliRunner().invoke(app, [*named, "--json"])
        assert result.exit_code == 0, result.output
    told = json.loads(result.stdout)
    assert told["log_likelihood_after"] > told["log_likelihood_before"] + 0.5
    return one_line((folder / "model.json").read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def led(learned: str, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Watch]:
    """The load led along a path that nobody trained on: by the plain filter, and by what was learned, recorded."""
    folder = tmp_path_factory.mktemp("led")
    watches = {}
    for name, model in (("plain", ""), ("learned", learned)):
        parameters = replace(hold(seed=7), mode=Mode.PATH, waypoints=ZIGZAG, path=Path())
        believes = seen(parameters, model=model, payload_drag_area_m2=PARCEL_M2)
        log = EventLogWriter(folder / f"{name}.swingd", swingd.__version__, parameters_to_json(believes))
        flight = Flight(dragged(believes), believes, log=log)
        watches[name] = watch = Watch(flight)
        flight.take_off().run_until_healthy(8.0).enter_offboard()
        flight.run_while(lambda flight=flight: state(flight) is not PathState.ARRIVED, 40.0)  # type: ignore[misc]
        flight.run(2.0)
        log.close()
        assert watch.known
        flight.recording = folder / f"{name}.swingd"  # type: ignore[attr-defined]
    return watches


def _begun_s(watch: Watch) -> float:
    return next(t_s for t_s, text in watch.flight.texts if text.startswith("path leading"))


def test_what_was_learned_makes_the_load_better_known_than_the_plain_filter_and_the_camera(
    led: dict[str, Watch],
) -> None:
    """Issue: below both, on a path that is not in the training data, with elasticity and load drag in the truth."""
    plain, gp = (rms(led[name].errors(_begun_s(led[name]))) for name in ("plain", "learned"))
    camera = rms(led["learned"].camera_errors(_begun_s(led["learned"])))
    print(f"load from the vehicle, RMS [m]: learned {gp:.3f}, plain {plain:.3f}, camera held {camera:.3f}")
    assert gp < 0.85 * plain
    assert gp < 0.6 * camera


def test_its_errors_are_as_large_as_it_says(led: dict[str, Watch]) -> None:
    watch = led["learned"]
    nees = float(np.mean(watch.nees(_begun_s(watch))))
    print(f"NEES of r and v, mean: {nees:.2f} of 4")
    assert 0.4 < nees < 5.0, "chi-square with 4 degrees of freedom, but errors last for a second"
    errors = watch.errors(_begun_s(watch))
    deviations = np.array([np.sqrt(np.diag(one.P)[3:5]) for one in watch.known if one.t_s >= _begun_s(watch)])
    assert np.mean(np.abs(errors) < 3.0 * deviations) > 0.99


def test_the_load_arrives_led_by_it(led: dict[str, Watch]) -> None:
    flight = led["learned"].flight
    begun_s = _begun_s(led["learned"])
    load = np.array([t.load_pos_ned_m for t in flight.truths if t.t_boot_s >= begun_s])
    corners = load[0] + np.array([(0.0, 0.0, 0.0), *((w.north_m, w.east_m, w.down_m) for w in ZIGZAG)])
    away, _ = errors_m(load, corners)
    assert math.sqrt(np.mean(away**2)) < 0.6
    assert math.dist(load[-1][:2], corners[-1][:2]) < 0.8


def test_its_recording_replays_byte_for_byte_without_the_models_file(led: dict[str, Watch]) -> None:
    run = replay(led["learned"].flight.recording, None, parameters_from_json)  # type: ignore[attr-defined]
    assert run.parameters.gp_ekf.model == "model.json"
    assert run.frames_sent > 2000
    assert run.frames_differing == 0, run.first_difference
