"""Copter's GUIDED mode by itself: limits, ends, timeouts."""

import itertools
from math import atan2, hypot, pi, radians

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from swingd.model.events import Vec3
from swingd.sim.cascade import AttitudeSetpoint, TrajectorySetpoint
from swingd.sim.copter_parameters import CopterParameters
from swingd.sim.guided import Guided, GuidedTarget

DT_S = 0.008
ORIGIN: Vec3 = (0.0, 0.0, -10.0)
REST: Vec3 = (0.0, 0.0, 0.0)


def vector(group: tuple[float | None, float | None, float | None]) -> Vec3:
    n, e, d = group
    assert n is not None
    assert e is not None
    assert d is not None
    return (n, e, d)


class Flight:
    """A vehicle that follows exactly."""

    def __init__(self, **parameters: float) -> None:
        self.parameters = CopterParameters(parameters)
        self.guided = Guided(self.parameters)
        self.guided.start(ORIGIN, REST, 0.0)
        self.t_s = 0.0
        self.track: list[TrajectorySetpoint] = []

    def tell(self, **target: object) -> None:
        pos, vel = (vector(self.track[-1].pos_ned_m), vector(self.track[-1].vel_ned_mps)) if self.track else (
            ORIGIN, REST)  # fmt: skip
        self.guided.tell(GuidedTarget(**target), self.t_s, pos, vel, 0.0)  # type: ignore[arg-type]

    def fly(self, duration_s: float) -> TrajectorySetpoint:
        for _ in range(round(duration_s / DT_S)):
            self.t_s += DT_S
            self.track.append(self.guided.step(DT_S, self.t_s))
        return self.track[-1]

    @property
    def accelerations(self) -> list[Vec3]:
        return [vector(sp.acc_ned_mps2) for sp in self.track]


def test_it_starts_where_it_is_and_stops() -> None:
    flight = Flight()
    flight.guided.start(ORIGIN, (3.0, 0.0, 0.0), 1.0)
    last = flight.fly(10.0)
    assert vector(last.vel_ned_mps) == pytest.approx(REST, abs=1e-3)
    north = vector(last.pos_ned_m)[0]
    assert 1.8 < north < 6.0  # v^2 / 2 a and the jerk
    assert last.yaw_rad == 1.0


def test_a_velocity_is_reached_within_acceleration_and_jerk() -> None:
    flight = Flight()
    flight.tell(vel_ned_mps=(4.0, -3.0, -1.0), yaw_rad=0.0)
    for _ in range(8):
        flight.fly(1.0)
        flight.tell(vel_ned_mps=(4.0, -3.0, -1.0), yaw_rad=0.0)
    assert vector(flight.track[-1].vel_ned_mps) == pytest.approx((4.0, -3.0, -1.0), abs=0.01)
    acc = flight.accelerations
    assert max(hypot(a[0], a[1]) for a in acc) == pytest.approx(2.5, abs=0.02)
    assert max(abs(a[2]) for a in acc) <= 1.0 + 1e-9
    jerks = [hypot(b[0] - a[0], b[1] - a[1]) / DT_S for a, b in itertools.pairwise(acc)]
    assert max(jerks) <= 5.0 + 1e-6


@pytest.mark.parametrize("timeout_s", [1.0, 3.0])
@pytest.mark.parametrize("kind", ["velocity", "acceleration", "path"])
def test_targets_that_stop_coming_stop_the_vehicle(timeout_s: float, kind: str) -> None:
    flight = Flight(GUID_TIMEOUT=timeout_s)
    target: dict[str, Vec3] = {
        "velocity": {"vel_ned_mps": (2.0, 0.0, 0.0)},
        "acceleration": {"acc_ned_mps2": (0.5, 0.0, 0.0)},
        "path": {"pos_ned_m": ORIGIN, "vel_ned_mps": (2.0, 0.0, 0.0)},
    }[kind]
    flight.tell(**target)
    moving = flight.fly(timeout_s - 0.05)
    assert vector(moving.vel_ned_mps)[0] > 0.4
    if kind != "path":  # which catches up with its point first
        fastest = max(vector(sp.vel_ned_mps)[0] for sp in flight.track)
        flight.fly(0.6)
        assert flight.accelerations[-1][0] < 0.0
        assert vector(flight.track[-1].vel_ned_mps)[0] < fastest + 0.7
    flight.fly(10.0)
    stopped = flight.track[-1]
    assert vector(stopped.vel_ned_mps) == pytest.approx(REST, abs=1e-3)
    assert vector(flight.fly(5.0).pos_ned_m) == pytest.approx(vector(stopped.pos_ned_m), abs=1e-2)


def test_a_position_is_kept_for_ever_and_approached_on_the_straight_line() -> None:
    flight = Flight()
    goal = (60.0, -30.0, -20.0)
    flight.tell(pos_ned_m=goal, yaw_rad=0.5)
    flight.fly(60.0)
    assert vector(flight.track[-1].pos_ned_m) == pytest.approx(goal, abs=1e-2)
    for sp in flight.track:
        n, e, d = vector(sp.pos_ned_m)
        assert e == pytest.approx(-0.5 * n, abs=0.05)
        assert d == pytest.approx(-10.0 - n / 6.0, abs=2.0)
    speeds = [vector(sp.vel_ned_mps) for sp in flight.track]
    assert max(hypot(v[0], v[1]) for v in speeds) <= 10.0 + 0.01
    assert max(-v[2] for v in speeds) <= 2.5 + 0.01
    # Nothing is overshot by more than the nested laws leave.
    assert max(vector(sp.pos_ned_m)[0] for sp in flight.track) < 60.3


@given(
    steps=st.lists(
        st.tuples(
            st.sampled_from(["pos", "vel", "acc", "path", "stop"]),
            st.tuples(*[st.floats(-8.0, 8.0) for _ in range(3)]),
            st.floats(0.1, 2.0),
        ),
        min_size=1,
        max_size=6,
    )
)
@settings(max_examples=50, deadline=None)
def test_what_is_flown_is_always_the_integral_of_a_limited_jerk(
    steps: list[tuple[str, tuple[float, float, float], float]],
) -> None:
    flight = Flight()
    for kind, value, duration_s in steps:
        targets: dict[str, dict[str, object]] = {
            "pos": {"pos_ned_m": value},
            "vel": {"vel_ned_mps": value},
            "acc": {"acc_ned_mps2": value},
            "path": {"pos_ned_m": value, "vel_ned_mps": value, "acc_ned_mps2": value},
            "stop": {},
        }
        flight.tell(**targets[kind])
        before = len(flight.track)
        flight.fly(duration_s)
        part = flight.track[before:]
        for a, b in itertools.pairwise(part):
            va, vb, acc = vector(a.vel_ned_mps), vector(b.vel_ned_mps), vector(a.acc_ned_mps2)
            jerk = [(y - x) / DT_S for x, y in zip(acc, vector(b.acc_ned_mps2), strict=True)]
            assert hypot(jerk[0], jerk[1]) <= 5.0 + 1e-6
            assert abs(jerk[2]) <= 5.0 + 1e-6
            assert vb == pytest.approx([v + c * DT_S for v, c in zip(va, acc, strict=True)], abs=1e-9)


def test_between_messages_a_path_moves_on() -> None:
    flight = Flight()
    for i in range(30):
        # One message a second of a point that runs at 2 m/s.
        flight.tell(pos_ned_m=(2.0 * i, 0.0, -10.0), vel_ned_mps=(2.0, 0.0, 0.0), yaw_rad=0.0)
        flight.fly(1.0)
    assert vector(flight.track[-1].pos_ned_m)[0] == pytest.approx(60.0, abs=0.2)
    assert vector(flight.track[-1].vel_ned_mps)[0] == pytest.approx(2.0, abs=0.05)


# ------------------------------------------------------------------------- yaw


def test_yaw_is_slewed_rated_relative_or_ahead() -> None:
    flight = Flight()
    flight.tell(vel_ned_mps=REST, yaw_rad=2.0)
    flight.fly(1.0)
    assert flight.track[-1].yaw_rad == pytest.approx(radians(60.0), abs=0.02)
    assert flight.track[-1].yaw_rate_radps == pytest.approx(radians(60.0))
    flight.fly(1.5)
    assert flight.track[-1].yaw_rad == pytest.approx(2.0)
    flight.tell(vel_ned_mps=REST, yaw_rad=0.5, yaw_is_relative=True)
    flight.fly(1.0)
    assert flight.track[-1].yaw_rad == pytest.approx(2.5)
    flight.tell(vel_ned_mps=REST, yaw_rate_radps=-0.4)
    flight.fly(2.0)
    assert flight.track[-1].yaw_rad == pytest.approx(1.7, abs=0.01)
    flight.fly(1.2)  # GUID_TIMEOUT
    stopped = flight.track[-1].yaw_rad
    assert stopped == pytest.approx(1.3, abs=0.01)
    flight.fly(2.0)
    assert flight.track[-1].yaw_rad == stopped
    flight.tell(vel_ned_mps=(-1.0, 1.0, 0.0))
    flight.fly(2.9)
    assert flight.track[-1].yaw_rad == pytest.approx(atan2(1.0, -1.0), abs=0.01)


def test_yaw_does_not_look_ahead_where_it_is_told_not_to() -> None:
    flight = Flight(WP_YAW_BEHAVIOR=0)
    flight.tell(vel_ned_mps=(-1.0, 1.0, 0.0))
    flight.fly(2.9)
    assert flight.track[-1].yaw_rad == 0.0


def test_yaw_turns_the_short_way_over_south() -> None:
    flight = Flight()
    flight.guided.start(ORIGIN, REST, 3.0)
    flight.tell(vel_ned_mps=REST, yaw_rad=-3.0)
    flight.fly(0.5)
    assert flight.track[-1].yaw_rad == pytest.approx(-3.0)
    assert all(abs(sp.yaw_rad or 0.0) >= 2.99 for sp in flight.track)
    assert all(abs(sp.yaw_rad or 0.0) <= pi for sp in flight.track)


# -------------------------------------------------------------------- attitude


def test_an_attitude_goes_level_after_the_timeout_and_ends_with_a_target() -> None:
    flight = Flight()
    asked = AttitudeSetpoint((0.99, 0.1, 0.1, 0.0), climb_mps=1.0)
    flight.guided.tell_attitude(asked, 0.0)
    assert flight.guided.attitude(2.9, 0.7) is asked
    level = flight.guided.attitude(3.1, 0.7)
    assert level is not None
    assert level.ned_from_frd == pytest.approx(((1.0 + 0.7648421873) ** 0.5 / 2**0.5, 0.0, 0.0, 0.3428978), abs=1e-6)
    assert level.climb_mps == 0.0
    flight.tell(vel_ned_mps=REST)
    assert flight.guided.attitude(3.2, 0.7) is None


# ------------------------------------------------------------------ parameters


def test_changed_parameters_act_on_the_loops() -> None:
    parameters = CopterParameters({"PSC_VELXY_P": 1.5})
    assert parameters.loops["MPC_XY_VEL_P_ACC"] == 1.5
    version = parameters.loops.version
    assert parameters.set("RTL_ALT", 2500)
    assert parameters.loops["RTL_RETURN_ALT"] == 25.0
    assert parameters.loops.version > version
    assert not parameters.set("RTL_ALT", float("nan"))
    assert not parameters.set("MPC_XY_P", 1.0)
    with pytest.raises(KeyError, match="WPNAV_SPEEED"):
        CopterParameters({"WPNAV_SPEEED": 1.0})


@pytest.mark.parametrize("name", ["WPNAV_ACCEL", "WPNAV_ACCEL_Z", "PSC_JERK_XY", "PSC_JERK_Z", "WPNAV_SPEED"])
def test_limits_of_nothing_do_not_break_it(name: str) -> None:
    flight = Flight(**{name: 0.0})
    flight.tell(pos_ned_m=(5.0, 5.0, -15.0))
    flight.fly(5.0)
    flight.tell(vel_ned_mps=(5.0, 5.0, -1.0))
    assert all(abs(value) < 100.0 for value in vector(flight.fly(2.0).pos_ned_m))
