"""The reference of mode hold."""

import math
from typing import Any

import pytest

from swingd.model.events import AppSetpoint, AutopilotKind, FlightMode, LocalPosition, SetpointUse
from swingd.model.parameters import Hold
from swingd.pipeline.merge import Reference
from swingd.pipeline.reference import HoldReference

OFFBOARD, OTHER = FlightMode.OFFBOARD, FlightMode.OTHER
PX4, ARDUPILOT = AutopilotKind.PX4, AutopilotKind.ARDUPILOT
PLAIN = SetpointUse.VEL_N | SetpointUse.VEL_E | SetpointUse.YAW


def asked(t_s: float, vel: tuple[float, float, float] = (1.0, 2.0, 0.0), **changes: Any) -> AppSetpoint:
    values: dict[str, Any] = {
        "use": SetpointUse.VEL,
        "pos_ned_m": (0.0, 0.0, 0.0),
        "vel_ned_mps": vel,
        "acc_ned_mps2": (0.0, 0.0, 0.0),
        "yaw_rad": 0.0,
        "yaw_rate_radps": 0.0,
    }
    return AppSetpoint(t_s, **{**values, **changes})


def at_height(reference: HoldReference, down_m: float, t_mono_s: float = 0.0) -> None:
    reference.add_position(LocalPosition(t_mono_s, 0.0, (4.0, 5.0, down_m), (0.0, 0.0, 0.0)))


def holding(**hold: Any) -> HoldReference:
    """In OFFBOARD since 0 s at 8 m, nose at 0.3 rad."""
    reference = HoldReference(Hold(**hold))
    at_height(reference, -8.0)
    reference.at(-0.1, OTHER, 0.3, PX4)
    reference.at(0.0, OFFBOARD, 0.3, PX4)
    return reference


def test_altitude_and_yaw_of_the_entry_are_kept() -> None:
    reference = holding(vel_ned_mps=(0.5, 0.0, 0.0))
    at_height(reference, -6.5)
    answer = reference.at(1.0, OFFBOARD, 1.2, PX4)
    assert answer == Reference(PLAIN | SetpointUse.POS_D, (0.0, 0.0, -8.0), (0.5, 0.0, 0.0), yaw_rad=0.3)


def test_outside_of_offboard_the_stream_follows_the_vehicle() -> None:
    reference = holding()
    at_height(reference, -3.0, 1.0)
    answer = reference.at(1.0, OTHER, -2.0, PX4)
    assert (answer.pos_ned_m[2], answer.yaw_rad) == (-3.0, -2.0)
    at_height(reference, -2.0, 1.1)
    answer = reference.at(1.1, OFFBOARD, -1.9, PX4)
    assert (answer.pos_ned_m[2], answer.yaw_rad) == (-2.0, -1.9), "a new entry, a new altitude"


@pytest.mark.parametrize("hold", [{"hold_altitude": False}, {"vel_ned_mps": (0.0, 0.0, -0.5)}])
def test_without_an_altitude_to_hold_the_vertical_velocity_is_meant(hold: dict[str, Any]) -> None:
    answer = holding(**hold).at(1.0, OFFBOARD, 0.3, PX4)
    assert answer.use == PLAIN | SetpointUse.VEL_D
    assert answer.vel_ned_mps[2] == hold.get("vel_ned_mps", (0.0, 0.0, 0.0))[2]


def test_without_a_position_the_vertical_velocity_is_meant() -> None:
    assert HoldReference(Hold()).at(0.0, OFFBOARD, 0.0, PX4).use == PLAIN | SetpointUse.VEL_D


def test_a_stale_position_is_no_altitude_to_hold() -> None:
    reference = HoldReference(Hold())
    at_height(reference, -8.0, 0.0)
    assert reference.at(0.4, OTHER, 0.0, PX4).use & SetpointUse.POS_D
    assert reference.at(0.6, OTHER, 0.0, PX4).use & SetpointUse.VEL_D
    assert reference.at(0.7, OFFBOARD, 0.0, PX4).use & SetpointUse.VEL_D
    at_height(reference, -7.0, 0.8)
    reference.restarted()
    assert reference.at(0.8, OFFBOARD, 0.0, PX4).use & SetpointUse.VEL_D, "nor one of before the autopilot's restart"


def test_other_parameters_leave_what_was_set() -> None:
    reference = holding()
    reference.set(asked(1.0))
    reference.configure(Hold(vel_ned_mps=(0.3, 0.0, 0.0), setpoint_timeout_s=0.5))
    assert reference.at(1.4, OFFBOARD, 0.3, PX4).vel_ned_mps == (1.0, 2.0, 0.0)
    assert reference.at(1.6, OFFBOARD, 0.3, PX4).vel_ned_mps == (0.3, 0.0, 0.0)
    assert reference.at(1.6, OFFBOARD, 0.3, PX4).pos_ned_m[2] == -8.0


def test_after_a_climb_the_new_altitude_is_held() -> None:
    reference = holding()
    reference.set(asked(1.0, (0.0, 0.0, -1.0)))
    at_height(reference, -9.5, 1.5)
    assert reference.at(1.5, OFFBOARD, 0.3, PX4).use & SetpointUse.VEL_D
    reference.set(asked(1.6, (0.0, 0.0, 0.0)))
    at_height(reference, -9.7, 1.6)
    assert reference.at(1.6, OFFBOARD, 0.3, PX4).pos_ned_m[2] == -9.5


def test_a_reference_that_is_not_repeated_falls_back() -> None:
    reference = holding(vel_ned_mps=(0.2, 0.0, 0.0), setpoint_timeout_s=0.7)
    assert reference.set(asked(10.0))
    assert reference.at(10.69, OFFBOARD, 0.3, PX4).vel_ned_mps == (1.0, 2.0, 0.0)
    assert reference.at(10.71, OFFBOARD, 0.3, PX4).vel_ned_mps == (0.2, 0.0, 0.0)
    assert reference.at(10.6, OFFBOARD, 0.3, PX4).vel_ned_mps == (0.2, 0.0, 0.0), "gone is gone"


def test_a_yaw_that_is_given_stays_when_the_reference_ends() -> None:
    reference = holding()
    reference.set(asked(1.0, use=SetpointUse.VEL | SetpointUse.YAW, yaw_rad=-1.0))
    assert reference.at(1.1, OFFBOARD, 0.3, PX4).yaw_rad == -1.0
    assert reference.at(9.0, OFFBOARD, 0.3, PX4).yaw_rad == -1.0


def test_an_unused_vertical_velocity_is_none() -> None:
    reference = holding()
    reference.set(asked(1.0, (1.0, 2.0, 3.0), use=SetpointUse.VEL_N | SetpointUse.VEL_E))
    answer = reference.at(1.0, OFFBOARD, 0.3, PX4)
    assert answer.vel_ned_mps == (1.0, 2.0, 0.0)
    assert answer.use & SetpointUse.POS_D


@pytest.mark.parametrize(
    "use",
    [
        SetpointUse.NONE,
        SetpointUse.VEL_N,
        SetpointUse.VEL_E | SetpointUse.VEL_D,
        SetpointUse.POS,
        SetpointUse.VEL | SetpointUse.POS_D,
        SetpointUse.VEL | SetpointUse.ACC_N,
        SetpointUse.YAW,
    ],
)
def test_anything_but_a_horizontal_velocity_is_refused_and_counted(use: SetpointUse) -> None:
    reference = holding()
    reference.set(asked(1.0, (0.1, 0.0, 0.0)))
    assert not reference.set(asked(1.1, use=use))
    assert reference.refused == 1
    assert reference.at(1.2, OFFBOARD, 0.3, PX4).vel_ned_mps == (0.1, 0.0, 0.0), "the one before stands"


def test_a_yaw_reset_turns_the_hold() -> None:
    reference = holding()
    reference.turn(math.pi / 2.0)
    assert reference.at(1.0, OFFBOARD, 2.0, PX4).yaw_rad == pytest.approx(0.3 + math.pi / 2.0)
    reference.turn(math.pi)
    assert reference.at(1.0, OFFBOARD, 2.0, PX4).yaw_rad == pytest.approx(0.3 - math.pi / 2.0)


def test_copter_holds_its_altitude_by_the_climb() -> None:
    """It takes a velocity whole or not at all: a position with it would drop one of the two."""
    reference = HoldReference(Hold())
    at_height(reference, -8.0)
    reference.at(-0.1, OTHER, 0.3, ARDUPILOT)
    reference.at(0.0, OFFBOARD, 0.3, ARDUPILOT)
    for down_m, climb_mps in ((-8.0, 0.0), (-7.8, -0.2), (-8.3, 0.3), (-5.0, -0.5)):
        at_height(reference, down_m, 1.0)
        answer = reference.at(1.0, OFFBOARD, 0.3, ARDUPILOT)
        assert answer.use == PLAIN | SetpointUse.VEL_D
        assert answer.vel_ned_mps == pytest.approx((0.0, 0.0, climb_mps))
