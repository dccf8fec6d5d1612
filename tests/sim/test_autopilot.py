"""Modes and closed loops of the simulated autopilot, flown with plant and sensors against PX4's measured behaviour."""

from collections.abc import Callable
from math import atan2, cos, degrees, hypot, pi, sin
from typing import Any

import numpy as np
import pytest
from pymavlink.dialects.v20 import common as mavlink

from swingd.model.events import LandedState
from swingd.sim.autopilot import NavState
from swingd.sim.plant import Truth

from .rigs import Application, in_the_air, iris, velocity

OFFBOARD = (1.0, 6.0, 0.0)


def tilt_deg(truth: Truth) -> float:
    _, x, y, _ = truth.ned_from_frd
    return degrees(2.0 * hypot(x, y))


def test_takes_off_holds_and_lands() -> None:
    app = Application(iris())
    app.take_off()
    assert app.peer.autopilot.nav_state is NavState.LOITER
    truth = app.peer.truth()
    assert truth.pos_ned_m == pytest.approx((0.0, 0.0, -8.0), abs=0.3)
    assert app.peer.autopilot.landed_state is LandedState.IN_AIR
    app.command(mavlink.MAV_CMD_NAV_LAND)
    rows = app.run(16.0)
    sink = [row.vel_ned_mps[2] for row in rows if -3.0 < row.pos_ned_m[2] < -1.7]
    assert np.mean(sink) == pytest.approx(0.7, abs=0.1)
    assert rows[-1].grounded
    assert not app.peer.autopilot.armed
    assert app.peer.autopilot.landed_state is LandedState.ON_GROUND


def test_take_off_is_smooth() -> None:
    app = Application(iris())
    app.run(0.5)
    app.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1.0)
    app.command(mavlink.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, 0, 0, 0, float("nan"))
    rows = app.run(18.0)
    lifted = [row for row in rows if row.pos_ned_m[2] < -0.05]
    assert 3.0 < lifted[0].t_boot_s < 6.0  # spool-up 1 s, ramp 3 s
    assert max(row.vel_ned_mps[2] for row in lifted) < 0.3
    assert min(row.vel_ned_mps[2] for row in lifted) > -2.0
    assert min(row.pos_ned_m[2] for row in rows) > -8.6


def test_disarms_itself_when_nothing_takes_off() -> None:
    app = Application(iris())
    app.run(0.5)
    app.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1.0)
    app.run(9.0)
    assert app.peer.autopilot.armed
    assert app.peer.truth().pos_ned_m[2] == pytest.approx(0.0, abs=0.01)
    app.run(2.0)
    assert not app.peer.autopilot.armed


def test_disarming_in_the_air_needs_force() -> None:
    app = Application(iris())
    app.keep = True
    app.take_off()
    app.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 0.0)
    app.run(0.1)
    assert app.peer.autopilot.armed
    app.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 0.0, 21196.0)
    app.run(0.5)
    assert not app.peer.autopilot.armed
    assert app.peer.truth().vel_ned_mps[2] > 3.0
    assert app.acks()[mavlink.MAV_CMD_COMPONENT_ARM_DISARM] == [0, mavlink.MAV_RESULT_DENIED, 0]


def test_offboard_is_refused_without_a_fresh_stream() -> None:
    app = Application(iris())
    app.keep = True
    app.take_off()
    app.command(mavlink.MAV_CMD_DO_SET_MODE, *OFFBOARD)
    app.run(0.1)
    assert app.peer.autopilot.nav_state is NavState.LOITER
    app.send(velocity(0.0, 0.0))
    app.run(1.2)  # longer than COM_OF_LOSS_T
    app.command(mavlink.MAV_CMD_DO_SET_MODE, *OFFBOARD)
    app.run(0.1)
    assert app.peer.autopilot.nav_state is NavState.LOITER
    app.offboard()
    assert app.peer.autopilot.nav_state is NavState.OFFBOARD
    assert app.acks()[mavlink.MAV_CMD_DO_SET_MODE] == [1, 1, 0]


def test_setpoints_outside_offboard_are_ignored() -> None:
    app = in_the_air(iris())
    app.setpoint = lambda t_s: velocity(3.0, 0.0)
    app.run(3.0)
    assert app.peer.autopilot.nav_state is NavState.LOITER
    assert abs(app.peer.truth().vel_ned_mps[0]) < 0.3


@pytest.mark.parametrize(
    ("action", "expected"),
    [(0, NavState.DESCEND), (3, NavState.RTL), (4, NavState.LAND), (5, NavState.LOITER)],
)
def test_loss_of_the_stream_triggers_the_action_after_one_second(action: int, expected: NavState) -> None:
    app = Application(iris(), {"COM_OBL_RC_ACT": action, "MIS_TAKEOFF_ALT": 20.0})
    app.take_off()
    app.offboard(lambda t_s: velocity(2.0, 0.0, down_m=-12.0))
    app.run(4.0)
    app.setpoint = None
    app.run(0.97)
    assert app.peer.autopilot.nav_state is NavState.OFFBOARD
    app.run(0.06)
    assert app.peer.autopilot.nav_state is expected
    assert app.peer.autopilot.failsafe
    rows = app.run(4.0)
    vel = np.mean([row.vel_ned_mps for row in rows[-250:]], axis=0)
    if expected is NavState.DESCEND:
        # Sinks at 0.7 m/s and stays level, whatever the wind and the speed do.
        assert vel[2] == pytest.approx(0.7, abs=0.1)
        assert max(tilt_deg(row) for row in rows[-500:]) < 1.0
        assert vel[0] > 0.5
    elif expected is NavState.LAND:
        assert vel[2] > 0.6
        assert abs(vel[0]) < 0.3
    elif expected is NavState.LOITER:
        assert np.linalg.norm(vel) < 0.3

    # The stream comes back: OFFBOARD returns by itself.
    app.setpoint = lambda t_s: velocity(0.0, 0.0, down_m=-12.0)
    app.run(0.1)
    assert app.peer.autopilot.nav_state is NavState.OFFBOARD
    assert not app.peer.autopilot.failsafe


def test_a_mode_asked_for_ends_the_return_to_offboard() -> None:
    app = Application(iris(), {"COM_OBL_RC_ACT": 5})
    app.take_off()
    app.offboard()
    app.command(mavlink.MAV_CMD_DO_SET_MODE, 1.0, 4.0, 3.0)
    app.run(2.0)
    assert app.peer.autopilot.nav_state is NavState.LOITER


def test_a_slow_stream_keeps_offboard_alive() -> None:
    """2.5 Hz is enough; the last setpoint is flown meanwhile."""
    app = in_the_air(iris())
    app.offboard()
    app.setpoint = None
    for _ in range(10):
        app.send(velocity(1.0, 0.0))
        app.run(0.4)
    assert app.peer.autopilot.nav_state is NavState.OFFBOARD
    assert app.peer.truth().vel_ned_mps[0] == pytest.approx(1.0, abs=0.3)


def test_take_off_in_offboard() -> None:
    app = Application(iris())
    app.run(0.5)
    app.offboard(lambda t_s: velocity(0.0, 0.0, down_m=-3.0))
    app.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1.0)
    app.run(12.0)
    assert app.peer.truth().pos_ned_m[2] == pytest.approx(-3.0, abs=0.3)


def setpoint_message(frame: int, use: int, **values: float) -> Any:
    """Only the fields whose bits are in ``use`` are meant (POSITION_TARGET_TYPEMASK inverted)."""
    fields = dict.fromkeys(("x", "y", "z", "vx", "vy", "vz", "afx", "afy", "afz", "yaw", "yaw_rate"), 0.0)
    fields.update(values)
    return mavlink.MAVLink_set_position_target_local_ned_message(0, 1, 1, frame, ~use & 0xDFF, **fields)


VEL, ACC, POS_Z, YAW = 0b111000, 0b111000000, 0b100, 1 << 10


@pytest.mark.parametrize(
    ("use", "values", "vel", "down_m"),
    [
        (VEL, {"vx": 1.0, "vy": -0.5}, (1.0, -0.5), None),
        (VEL | ACC, {"vx": 1.0, "vy": -0.5}, (1.0, -0.5), None),
        (0b011000 | POS_Z, {"vx": 1.0, "z": -7.0}, (1.0, 0.0), -7.0),
        (0b111 | VEL, {"x": 2.0, "y": 1.0, "z": -9.0}, (0.0, 0.0), -9.0),
        (0b111, {"x": 2.0, "y": 1.0, "z": -9.0}, (0.0, 0.0), -9.0),
    ],
    ids=["velocity", "velocity and acceleration", "position z, velocity xy", "position and velocity", "position"],
)
def test_masks_in_local_ned_are_flown(
    use: int, values: dict[str, float], vel: tuple[float, float], down_m: float | None
) -> None:
    app = in_the_air(iris())
    app.offboard(lambda t_s: setpoint_message(mavlink.MAV_FRAME_LOCAL_NED, use | YAW, **values))
    rows = app.run(10.0)
    mean = np.mean([row.vel_ned_mps for row in rows[-580:]], axis=0)
    assert mean[:2] == pytest.approx(vel, abs=0.12)
    if down_m is not None:
        assert rows[-1].pos_ned_m[2] == pytest.approx(down_m, abs=0.15)
    if "x" in values:
        assert rows[-1].pos_ned_m[:2] == pytest.approx((2.0, 1.0), abs=0.25)


def test_acceleration_alone_is_flown() -> None:
    app = in_the_air(iris())
    app.offboard(lambda t_s: setpoint_message(mavlink.MAV_FRAME_LOCAL_NED, 0b011000000 | POS_Z | YAW, afx=1.0, z=-8.0))
    rows = app.run(2.0)
    assert rows[-1].vel_ned_mps[0] > 0.9
    assert rows[-1].pos_ned_m[2] == pytest.approx(-8.0, abs=0.3)


def test_velocity_in_body_ned_is_turned_by_yaw() -> None:
    app = in_the_air(iris())
    app.offboard(lambda t_s: velocity(0.0, 0.0, yaw=pi / 2))
    app.run(6.0)
    assert app.peer.truth().yaw_rad == pytest.approx(pi / 2, abs=0.05)
    app.setpoint = lambda t_s: setpoint_message(mavlink.MAV_FRAME_BODY_NED, VEL | YAW, vx=1.0, yaw=pi / 2)
    rows = app.run(8.0)
    assert np.mean([row.vel_ned_mps for row in rows[-580:]], axis=0) == pytest.approx((0.0, 1.0, 0.0), abs=0.12)


@pytest.mark.parametrize("direction", [(3.0, 0.0), (0.0, 3.0)])
def test_velocity_step_swings_the_load_as_real_px4_does(direction: tuple[float, float]) -> None:
    """0.3 kg on 1.5 m, 0 -> 3 m/s: peak 29.5 deg, period 2.33 s, damping ratio 0.06, 16 s until under 2 deg."""
    app = in_the_air(iris())
    app.offboard()
    app.run(4.0)
    app.setpoint = lambda t_s: velocity(*direction)
    start = app.t_s
    rows = app.run(22.0)
    chi = np.degrees([row.chi_rad for row in rows])
    t = np.array([row.t_boot_s for row in rows]) - start
    assert chi.max() == pytest.approx(29.5, rel=0.05)
    assert t[np.nonzero(chi > 2.0)[0][-1]] == pytest.approx(16.0, abs=1.5)
    swing = np.degrees([row.zeta_rad if direction[0] else row.xi_rad for row in rows])
    swing -= swing[-580:].mean()
    turns = [i for i in range(500, len(swing) - 1) if (swing[i] - swing[i - 1]) * (swing[i + 1] - swing[i]) < 0.0]
    turns = [i for i in turns if abs(swing[i]) > 1.5]
    assert 2.0 * np.diff(t[turns]).mean() == pytest.approx(2.33, rel=0.01)
    decrement = -np.polyfit(np.arange(len(turns)), np.log(np.abs(swing[turns])), 1)[0] / pi
    assert decrement == pytest.approx(0.06, abs=0.006)
    # Forward leaves the load behind: zeta < 0; to the right leaves it to the left: xi > 0.
    first = swing[np.argmax(chi)]
    assert first < -20.0 if direction[0] else first > 20.0


PX4_RESPONSE = {
    0.20: ((0.84, -44.0), (0.93, -6.0)),
    0.43: ((0.59, -77.0), (1.00, -18.0)),
    0.80: ((0.37, -112.0), (1.07, -39.0)),
    1.50: ((0.20, -172.0), (1.06, -92.0)),
}
"""Commanded to true acceleration of PX4 v1.16 SITL, bare 1.5 kg quadrotor, +-0.8 m/s^2: gain and phase [deg]."""


@pytest.mark.parametrize("f_hz", PX4_RESPONSE)
@pytest.mark.parametrize("fed", [False, True], ids=["velocity", "velocity and acceleration"])
def test_acceleration_responds_as_on_real_px4(f_hz: float, fed: bool) -> None:
    gain_px4, phase_px4 = PX4_RESPONSE[f_hz][fed]
    w, amplitude = 2.0 * pi * f_hz, 0.8
    app = in_the_air(iris(load_kg=0.01), released=True)
    app.offboard()
    start = app.t_s

    def sine(t_s: float) -> Any:
        phase = w * (t_s - start)
        acc = (amplitude * cos(phase), 0.0) if fed else None
        return velocity(amplitude / w * sin(phase), 0.0, acc=acc)

    app.setpoint = sine
    settle_s, periods = 6.0, max(2, round(4.0 * f_hz))
    rows = app.run(settle_s + periods / f_hz)
    rows = rows[-round(periods / f_hz / 0.004) :]
    t = np.array([row.t_boot_s for row in rows]) - start
    acc = np.array([row.acc_ned_mps2[0] for row in rows])
    response = 2.0 * np.mean(acc * np.exp(-1j * w * t)) / amplitude
    assert abs(response) == pytest.approx(gain_px4, rel=0.06)
    assert degrees(atan2(response.imag, response.real)) == pytest.approx(phase_px4, abs=5.0)


def test_altitude_holds_while_the_battery_sags() -> None:
    app = Application(iris(battery_empty_v=13.8, battery_drain_s=60.0))
    app.take_off()
    rows = app.run(45.0)
    assert rows[-1].thrust_factor == pytest.approx((13.8 / 16.2) ** 2, rel=1e-3)
    assert max(abs(row.pos_ned_m[2] + 8.0) for row in rows) < 0.25
    # The throttle makes up for it: 0.587 at 16.2 V, 0.707 at 13.8 V for 1.8 kg.
    assert app.peer.autopilot.thrust_sp == pytest.approx(0.707, abs=0.01)
    # PX4's estimate follows with a lag of a quarter of a minute, the integrator covers the rest.
    assert 0.65 < app.peer.autopilot.hover_thrust < 0.707


def test_a_released_load_is_survived() -> None:
    app = in_the_air(iris())
    app.peer.plant.release()
    rows = app.run(12.0)
    assert max(abs(row.pos_ned_m[2] + 8.0) for row in rows) < 0.5
    assert rows[-1].pos_ned_m[2] == pytest.approx(-8.0, abs=0.15)


def test_return_flies_home_and_lands() -> None:
    app = Application(iris(), {"RTL_RETURN_ALT": 12.0})
    app.take_off()
    app.offboard(lambda t_s: velocity(4.0, 0.0))
    app.run(6.0)
    assert app.peer.truth().pos_ned_m[0] > 15.0
    app.command(mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH)
    rows = app.run(55.0)
    assert min(row.pos_ned_m[2] for row in rows) < -11.0
    assert not app.peer.autopilot.armed
    assert hypot(*rows[-1].pos_ned_m[:2]) < 1.5


def test_reposition_flies_to_a_place() -> None:
    app = in_the_air(iris())
    lat = 47.397742 + degrees(6.0 / 6371000.0)
    app.send(
        mavlink.MAVLink_command_int_message(
            1,
            1,
            5,
            mavlink.MAV_CMD_DO_REPOSITION,
            0,
            0,
            -1.0,
            1.0,
            0.0,
            float("nan"),
            round(lat * 1e7),
            85455940,
            494.0,
        )
    )
    app.run(15.0)
    assert app.peer.truth().pos_ned_m == pytest.approx((6.0, 0.0, -6.0), abs=0.3)


@pytest.fixture(params=[0.0, 1.2, -2.5], ids="yaw {}".format)
def at_yaw(request: pytest.FixtureRequest) -> Callable[[float, float], Application]:
    yaw = float(request.param)

    def fly(ahead: float, right: float) -> Application:
        app = in_the_air(iris())
        app.offboard(lambda t_s: velocity(0.0, 0.0, yaw=yaw))
        app.run(8.0)
        north, east = cos(yaw) * ahead - sin(yaw) * right, sin(yaw) * ahead + cos(yaw) * right
        app.setpoint = lambda t_s: velocity(north, east, yaw=yaw)
        return app

    return fly


def test_accelerating_forward_leaves_the_load_behind_in_all_headings(
    at_yaw: Callable[[float, float], Application],
) -> None:
    app = at_yaw(2.0, 0.0)
    app.run(0.8)
    truth = app.peer.truth()
    assert degrees(truth.zeta_rad) < -8.0
    assert abs(degrees(truth.xi_rad)) < 3.0


def test_accelerating_to_the_right_leaves_the_load_to_the_left_in_all_headings(
    at_yaw: Callable[[float, float], Application],
) -> None:
    app = at_yaw(0.0, 2.0)
    app.run(0.8)
    truth = app.peer.truth()
    assert degrees(truth.xi_rad) > 8.0
    assert abs(degrees(truth.zeta_rad)) < 3.0
