"""What a camera's LANDING_TARGET becomes, whatever clock it stamps by, and what is refused of it."""

import math
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common as mavlink

from swingd.link.adapter import AutopilotAdapter, Drop
from swingd.link.codec import Codec
from swingd.model.events import LoadSighting, SightingFrame
from swingd.model.parameters import Link, Thrust

from .messages import attitude, imu, landing_target, px4_heartbeat

BOOT_MINUS_MONO_S = 200.0
"""The autopilot's clock over the host's, its quickest delivery included."""
UNIX_US = 1_700_000_000_000_000
PERIOD_S = 1 / 15


class Bench:
    """An adapter that knows the autopilot's clock, and a camera that talks to it."""

    def __init__(self, knows_clock: bool = True) -> None:
        self.adapter = AutopilotAdapter(Link(), Thrust())
        self._autopilot, self._ears = Codec(1, 1), Codec(1, 191)
        self.t_s = 50.0
        if knows_clock:
            self._hear(px4_heartbeat())
            self.run(0.0)

    def _hear(self, message: Any) -> None:
        self.adapter.receive(self.t_s, self._autopilot.encode(message))

    def run(self, duration_s: float) -> None:
        """Let time pass, in which the autopilot goes on."""
        for _ in range(max(round(duration_s / 0.02), 1)):
            self.t_s += 0.02 if duration_s else 0.0
            self._hear(imu(self.t_s + BOOT_MINUS_MONO_S))
            self._hear(attitude(self.t_s + BOOT_MINUS_MONO_S))

    def see(self, message: Any, sender: tuple[int, int] = (1, 100)) -> LoadSighting | None:
        (frame,) = self._ears.receive(Codec(*sender).encode(message))
        return self.adapter.sighting(self.t_s, frame)

    @property
    def boot_s(self) -> float:
        return self.t_s + BOOT_MINUS_MONO_S


def test_the_position_comes_in_its_frame_on_the_autopilots_clock() -> None:
    bench = Bench()
    seen = bench.see(landing_target(UNIX_US))
    assert seen is not None
    assert seen.position_m == pytest.approx((0.1, -0.2, 1.5))
    assert seen.frame is SightingFrame.BODY_FRD
    assert seen.t_mono_s == bench.t_s
    assert seen.t_boot_s == pytest.approx(bench.boot_s, abs=1e-3)
    absolute = bench.see(landing_target(UNIX_US + 66_000, (100.0, 20.0, -8.0), mavlink.MAV_FRAME_LOCAL_NED))
    assert absolute is not None
    assert absolute.frame is SightingFrame.LOCAL_NED


@pytest.mark.parametrize("epoch_us", [UNIX_US, 3_000_000])
def test_what_is_late_by_its_own_stamp_was_taken_earlier(epoch_us: int) -> None:
    """By unix time or the camera's boot time; whether it was there at once nobody can see."""
    bench = Bench()
    for number in range(30):
        bench.see(landing_target(epoch_us + round(1e6 * number * PERIOD_S)))
        bench.run(PERIOD_S)
    taken_s = bench.boot_s
    stamp_us = epoch_us + round(1e6 * 30 * PERIOD_S)
    bench.run(0.12)
    seen = bench.see(landing_target(stamp_us))
    assert seen is not None
    assert seen.t_boot_s == pytest.approx(taken_s, abs=0.02)


def test_a_camera_without_a_clock_counts_from_the_arrival() -> None:
    bench = Bench()
    for _ in range(3):
        seen = bench.see(landing_target(0))
        assert seen is not None
        assert seen.t_boot_s == pytest.approx(bench.boot_s, abs=1e-3)
        bench.run(PERIOD_S)
    assert sum(bench.adapter.drops.values()) == 0


def test_a_camera_that_starts_anew_is_followed() -> None:
    bench = Bench()
    for number in range(10):
        assert bench.see(landing_target(UNIX_US + round(1e6 * number * PERIOD_S))) is not None
        bench.run(PERIOD_S)
    seen = []
    for number in range(10):
        seen.append(bench.see(landing_target(7_000_000 + round(1e6 * number * PERIOD_S))))
        bench.run(PERIOD_S)
    assert seen[0] is None
    assert seen[-1] is not None
    assert seen[-1].t_boot_s == pytest.approx(bench.boot_s - PERIOD_S, abs=0.03)


@pytest.mark.parametrize(
    ("message", "reason"),
    [
        (landing_target(UNIX_US, valid=0), Drop.TARGET_FRAME),
        (landing_target(UNIX_US, frame=mavlink.MAV_FRAME_GLOBAL), Drop.TARGET_FRAME),
        (landing_target(UNIX_US, frame=mavlink.MAV_FRAME_BODY_NED), Drop.TARGET_FRAME),
        (landing_target(UNIX_US, (math.nan, 0.0, 1.0)), Drop.NOT_FINITE),
        (landing_target(UNIX_US, (0.0, math.inf, 1.0)), Drop.NOT_FINITE),
        (landing_target(UNIX_US, (0.0, 0.0, 1e30)), Drop.IMPOSSIBLE),
        (landing_target(2**64 - 1), Drop.IMPOSSIBLE),
    ],
)
def test_what_cannot_be_is_counted(message: Any, reason: Drop) -> None:
    bench = Bench()
    assert bench.see(message) is None
    assert bench.adapter.drops == {reason: 1}


def test_the_same_picture_twice_counts_once() -> None:
    bench = Bench()
    assert bench.see(landing_target(UNIX_US)) is not None
    assert bench.see(landing_target(UNIX_US)) is None
    assert bench.adapter.drops == {Drop.DUPLICATE: 1}


def test_one_camera_at_a_time_is_listened_to() -> None:
    bench = Bench()
    assert bench.see(landing_target(UNIX_US)) is not None
    assert bench.see(landing_target(5_000_000), sender=(1, 101)) is None
    assert bench.adapter.drops == {Drop.OTHER_SENDER: 1}
    bench.run(2.5)
    assert bench.see(landing_target(8_000_000), sender=(1, 101)) is not None


def test_before_the_autopilots_clock_is_known_it_says_nothing() -> None:
    bench = Bench(knows_clock=False)
    assert bench.see(landing_target(UNIX_US)) is None
    assert bench.adapter.drops == {Drop.NO_CLOCK: 1}


floats = st.floats(width=32, allow_nan=True, allow_infinity=True)


@given(
    st.lists(
        st.tuples(
            st.integers(0, 2**64 - 1), st.tuples(floats, floats, floats), st.integers(0, 255), st.integers(0, 255)
        ),
        max_size=12,
    )
)
def test_any_fields_give_a_finite_place_or_a_count(fields: list[tuple[Any, ...]]) -> None:
    bench = Bench()
    for stamp_us, position, frame, valid in fields:
        seen = bench.see(landing_target(stamp_us, position, frame, valid=valid))
        if seen is not None:
            assert all(map(math.isfinite, (seen.t_boot_s, *seen.position_m)))
            assert abs(seen.t_boot_s - bench.boot_s) < 2.0
        bench.run(0.04)
    assert sum(bench.adapter.drops.values()) <= len(fields)
