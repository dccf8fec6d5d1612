"""A bad link, a silent or restarted autopilot: the estimate stays finite and heals, the autopilot's failsafe acts."""

import itertools
import math
from collections.abc import Callable

import numpy as np
import pytest
from pymavlink.dialects.v20 import common as mavlink

from swingd.link.adapter import Drop
from swingd.link.codec import Codec
from swingd.model.actions import Health, SwingReport
from swingd.model.estimate import ResetReason
from swingd.sim.autopilot import NavState

from .flight import Flight, Spoil, hold

NORMAL_DEG = 0.35
"""Error of an unspoiled flight of this kind; see `test_the_unspoiled_flight`."""


def without(*msg_ids: int) -> Spoil:
    return lambda _t_s, frames: [raw for raw in frames if int.from_bytes(raw[7:10], "little") not in msg_ids]


def lossy(share: float) -> Spoil:
    random = np.random.default_rng(5)
    return lambda _t_s, frames: [raw for raw in frames if random.random() > share]


def doubled(_t_s: float, frames: list[bytes]) -> list[bytes]:
    return [raw for raw in frames for _ in range(2)]


class Reordered:
    """Delays a third of the frames by up to 60 ms, so that later ones overtake them."""

    def __init__(self) -> None:
        self._random = np.random.default_rng(6)
        self._waiting: list[tuple[float, bytes]] = []

    def __call__(self, t_s: float, frames: list[bytes]) -> list[bytes]:
        for raw in frames:
            late = self._random.random() < 0.33
            self._waiting.append((t_s + (self._random.uniform(0.0, 0.06) if late else 0.0), raw))
        due = [raw for at_s, raw in sorted(self._waiting, key=lambda waiting: waiting[0]) if at_s <= t_s]
        self._waiting = [waiting for waiting in self._waiting if waiting[0] > t_s]
        return due


class Garbled:
    """Flips a byte in one frame of ten and puts noise between them."""

    def __init__(self) -> None:
        self._random = np.random.default_rng(7)

    def __call__(self, _t_s: float, frames: list[bytes]) -> list[bytes]:
        out: list[bytes] = []
        for raw in frames:
            spoiled = bytearray(raw)
            if self._random.random() < 0.1:
                spoiled[self._random.integers(len(raw))] ^= 1 + self._random.integers(255)
            out += [self._random.bytes(self._random.integers(3)), bytes(spoiled)]
        return out


class ClockJump:
    """Shifts every stamp of the autopilot's clock."""

    def __init__(self, step_s: float) -> None:
        self._step_s = step_s
        self._codec = Codec(1, 1)

    def __call__(self, _t_s: float, frames: list[bytes]) -> list[bytes]:
        received = [frame for raw in frames for frame in self._codec.receive(raw)]
        return [self._shift(frame.message) if frame.system_id == 1 else frame.raw for frame in received]

    def _shift(self, message: object) -> bytes:
        fields = vars(message)
        if "time_usec" in fields:
            fields["time_usec"] += round(self._step_s * 1e6)
        if "time_boot_ms" in fields:
            fields["time_boot_ms"] += round(self._step_s * 1e3)
        return self._codec.encode(message)


def finite(reports: list[SwingReport]) -> bool:
    return all(
        math.isfinite(value)
        for report in reports
        for value in (
            *(report.xi_rad, report.zeta_rad, report.xi_rate_radps, report.zeta_rate_radps),
            *(report.xi_std_rad, report.zeta_std_rad, report.thrust_n, report.thrust_scale, report.nis),
            *(*report.force_ned_n, *report.correction_acc_ned_mps2, *report.correction_vel_ned_mps),
        )
    )


def swinging(flight: Flight) -> Flight:
    """Keep the vehicle moving, so that there is a swing to estimate."""
    flight.reference = (2.0, -1.0, 0.0) if flight.reference is None else (0.0, 0.0, 0.0)
    return flight


def test_the_unspoiled_flight(hovering: Callable[[], Flight]) -> None:
    flight = swinging(hovering()).run(4.0)
    swinging(flight).run(4.0)
    assert max(np.abs(flight.errors_deg()).ravel()) < 2.0
    assert flight.rmse_deg() < NORMAL_DEG


@pytest.mark.parametrize(
    ("make", "worst"),
    [
        (lambda: lossy(0.2), 2.0),
        (lambda: doubled, 1.1),
        (Reordered, 2.0),
        (Garbled, 2.0),
    ],
    ids=["20 % lost", "duplicates", "reordered", "garbled"],
)
def test_a_bad_link_costs_little_and_is_forgotten(
    hovering: Callable[[], Flight], make: Callable[[], Spoil], worst: float
) -> None:
    flight = swinging(hovering())
    flight.spoil = make()
    flight.run(5.0)
    begin_s, flight.spoil = flight.t_s, None
    swinging(flight).run(4.0)
    assert finite(flight.reports)
    assert flight.nav_state is NavState.OFFBOARD
    assert flight.rmse_deg(end_s=begin_s) < worst * NORMAL_DEG
    assert flight.rmse_deg(begin_s + 1.0) < 2.0 * NORMAL_DEG
    assert not any(flight.engine.pipeline.resets[reason] for reason in (ResetReason.GAP, ResetReason.NUMERICS))


def test_duplicates_and_late_frames_are_counted(hovering: Callable[[], Flight]) -> None:
    flight = hovering()
    before = dict(flight.engine.adapter.drops)
    flight.spoil = doubled
    flight.run(1.0)
    assert flight.engine.adapter.drops[Drop.DUPLICATE] - before.get(Drop.DUPLICATE, 0) > 400
    flight.spoil = Reordered()
    flight.run(1.0)
    assert flight.engine.adapter.drops[Drop.REORDERED] > 50


def test_a_gap_of_0_3_s_is_bridged(hovering: Callable[[], Flight]) -> None:
    flight = swinging(hovering()).run(1.5)
    flight.spoil = lambda _t_s, _frames: []
    flight.run(0.3)
    gap_end_s, flight.spoil = flight.t_s, None
    flight.run(5.0)
    assert finite(flight.reports)
    assert flight.nav_state is NavState.OFFBOARD
    assert flight.engine.pipeline.resets[ResetReason.GAP] == 0
    before = [report for report in flight.reports if report.t_boot_s <= gap_end_s]
    after = [report for report in flight.reports if report.t_boot_s > gap_end_s]
    sizes = [math.hypot(*report.correction_acc_ned_mps2) for report in (before[-1], after[0])]
    assert sizes[1] <= 0.5 * sizes[0], "what was guessed is not acted on, what was asked before fades meanwhile"
    assert sizes[0] > 0.1
    assert after[-1].health is Health.ACTIVE
    assert flight.rmse_deg(gap_end_s, gap_end_s + 1.0) < 3.0
    assert flight.rmse_deg(gap_end_s + 2.0) < 2.0 * NORMAL_DEG


def test_a_longer_gap_begins_anew(hovering: Callable[[], Flight]) -> None:
    flight = swinging(hovering()).run(1.5)
    flight.spoil = lambda _t_s, _frames: []
    flight.run(0.7)
    gap_end_s, flight.spoil = flight.t_s, None
    flight.run(6.0)
    assert finite(flight.reports)
    assert flight.engine.pipeline.resets[ResetReason.GAP] == 1
    assert flight.reports[-1].health is Health.ACTIVE
    assert flight.rmse_deg(gap_end_s + 3.0) < 2.0 * NORMAL_DEG


@pytest.mark.parametrize(
    "spoil",
    [without(mavlink.MAVLINK_MSG_ID_HIGHRES_IMU), lambda _t_s, _frames: []],
    ids=["no IMU", "nothing at all"],
)
def test_without_the_imu_the_stream_ends_and_the_failsafe_acts(hovering: Callable[[], Flight], spoil: Spoil) -> None:
    flight = hovering()
    flight.peer.px4.set("COM_OBL_RC_ACT", 5)
    flight.spoil = spoil
    stop_s = flight.t_s
    flight.run(0.7)
    assert flight.health is Health.FAULT
    assert flight.nav_state is NavState.OFFBOARD
    flight.run(0.5)
    assert flight.nav_state is NavState.LOITER, "COM_OF_LOSS_T is 1 s"
    assert max((t_s for t_s, _ in flight.setpoints), default=stop_s) < stop_s + 0.05
    flight.run(3.0)
    assert len([text for _, text in flight.texts if "has stopped" in text]) == 1, "told once"
    flight.forget()
    flight.spoil = None
    flight.run(0.5)
    assert flight.setpoints == [], "not before the estimate is good again"
    flight.run(4.0)
    assert flight.nav_state is NavState.OFFBOARD, "the autopilot comes back by itself"
    assert flight.health is Health.ACTIVE
    first = next(setpoint for _, setpoint in flight.setpoints if setpoint.acc_ned_mps2 != (0.0, 0.0, 0.0))
    assert math.hypot(*first.acc_ned_mps2) < 0.1


def test_without_the_attitude_the_correction_fades_and_the_stream_ends(hovering: Callable[[], Flight]) -> None:
    flight = hovering()
    flight.spoil = without(mavlink.MAVLINK_MSG_ID_ATTITUDE, mavlink.MAVLINK_MSG_ID_ATTITUDE_QUATERNION)
    stop_s = flight.t_s
    flight.run(1.6)
    assert flight.health is Health.FAULT
    assert max(t_s for t_s, _ in flight.setpoints) < stop_s + 0.2
    assert flight.nav_state is not NavState.OFFBOARD


def test_without_throttle_and_motors_it_flies_on_by_remark_1(hovering: Callable[[], Flight]) -> None:
    flight = hovering()
    flight.spoil = without(
        mavlink.MAVLINK_MSG_ID_ATTITUDE_TARGET,
        mavlink.MAVLINK_MSG_ID_SERVO_OUTPUT_RAW,
        mavlink.MAVLINK_MSG_ID_ACTUATOR_OUTPUT_STATUS,
    )
    swinging(flight).run(4.0)
    swinging(flight).run(4.0)
    assert finite(flight.reports)
    assert flight.nav_state is NavState.OFFBOARD
    assert flight.rmse_deg() < 3.0 * NORMAL_DEG


@pytest.mark.parametrize("step_s", [50.0, -15.0])
def test_a_jump_of_the_autopilots_clock_begins_anew(hovering: Callable[[], Flight], step_s: float) -> None:
    flight = swinging(hovering()).run(1.0)
    jump_s = flight.t_s
    flight.forget()
    flight.spoil = ClockJump(step_s)
    flight.run(6.0)
    assert finite(flight.reports)
    assert flight.engine.pipeline.resets[ResetReason.CLOCK] == 1
    assert any(text.startswith(f"autopilot's clock stepped by {step_s:+.1f} s") for _, text in flight.texts)
    stamps = [report.t_boot_s for report in flight.reports]
    assert all(b > a for a, b in itertools.pairwise(stamps)) or step_s < 0.0
    # The truth knows nothing of the shift.
    flight.truths = [
        type(truth)(**{name: getattr(truth, name) for name in truth.__slots__} | {"t_boot_s": truth.t_boot_s + step_s})
        for truth in flight.truths
    ]
    assert flight.rmse_deg(jump_s + step_s + 3.5) < 2.0 * NORMAL_DEG
    assert flight.nav_state is NavState.OFFBOARD
    assert flight.reports[-1].health is Health.ACTIVE


def test_an_autopilot_that_reboots_is_asked_for_its_streams_again() -> None:
    flight = Flight(hold())
    flight.run(4.0)
    flight.command(mavlink.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN, 1.0)
    flight.run(6.0)
    assert flight.engine.pipeline.resets[ResetReason.CLOCK] == 1
    flight.forget()
    flight.take_off().enter_offboard()
    assert flight.nav_state is NavState.OFFBOARD
    swinging(flight).run(3.0)
    begin_s = flight.t_s - flight.truths[-1].t_boot_s
    assert begin_s == pytest.approx(4.0, abs=0.1), "the autopilot's clock began anew"
    assert finite(flight.reports)
    assert flight.rmse_deg(flight.truths[-1].t_boot_s - 4.0) < 2.0 * NORMAL_DEG
    assert flight.health is Health.ACTIVE


def test_a_yaw_reset_of_the_autopilot_leaves_the_estimate_and_turns_the_hold(
    hovering: Callable[[], Flight],
) -> None:
    flight = swinging(hovering()).run(0.8)
    untouched = flight.fork()
    codec = Codec(1, 1)

    def turned(_t_s: float, frames: list[bytes]) -> list[bytes]:
        out = []
        for raw in frames:
            if int.from_bytes(raw[7:10], "little") == mavlink.MAVLINK_MSG_ID_ATTITUDE:
                message = codec.receive(raw)[0].message
                message.yaw = (message.yaw + 1.5 * math.pi) % (2.0 * math.pi) - math.pi
                raw = codec.encode(message)
            out.append(raw)
        return out

    yaw_rad = flight.setpoints[-1][1].yaw_rad if flight.setpoints else untouched.peer.truth().yaw_rad
    flight.forget()
    flight.spoil = turned
    # Before the vehicle, whose own yaw was not reset, answers to the turned setpoints.
    flight.run(0.05)
    untouched.run(0.05)
    pairs = list(zip(flight.reports, untouched.reports, strict=True))
    assert len(pairs) > 3
    for report, expected in pairs:
        assert report.xi_rad == pytest.approx(expected.xi_rad, abs=2e-3)
        assert report.zeta_rad == pytest.approx(expected.zeta_rad, abs=2e-3)
        assert report.xi_rate_radps == pytest.approx(expected.xi_rate_radps, abs=0.02)
        assert report.health is Health.ACTIVE
    last = flight.setpoints[-1][1]
    assert math.remainder(last.yaw_rad - yaw_rad - math.pi / 2.0, 2.0 * math.pi) == pytest.approx(0.0, abs=0.05)
    acc, expected_acc = last.acc_ned_mps2, untouched.setpoints[-1][1].acc_ned_mps2
    assert acc[:2] == pytest.approx((-expected_acc[1], expected_acc[0]), abs=0.1), "the same push, in the new north"
    assert math.hypot(*expected_acc) > 0.2
