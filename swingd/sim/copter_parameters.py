"""The parameters of Copter that the simulated autopilot obeys or that a companion asks for."""

from collections.abc import Mapping

from swingd.sim.parameter_table import ParameterTable
from swingd.sim.px4_parameters import Px4Parameters

DEFAULTS: Mapping[str, float | int] = {
    "ANGLE_MAX": 3000,
    "ARMING_CHECK": 1,
    "BATT_MONITOR": 4,
    "DISARM_DELAY": 10,
    "FRAME_CLASS": 1,
    "FRAME_TYPE": 1,
    "FS_GCS_ENABLE": 0,
    "FS_THR_ENABLE": 1,
    "GUID_OPTIONS": 0,
    "GUID_TIMEOUT": 3.0,
    "INS_GYRO_FILTER": 20,
    "LAND_SPEED": 50,
    "MOT_BAT_VOLT_MAX": 0.0,
    "MOT_BAT_VOLT_MIN": 0.0,
    "MOT_PWM_MAX": 2000,
    "MOT_PWM_MIN": 1000,
    "MOT_SPIN_ARM": 0.1,
    "MOT_SPIN_MAX": 1.0,
    "MOT_SPIN_MIN": 0.0,
    "MOT_THST_EXPO": 0.0,
    "MOT_THST_HOVER": 0.5,
    "PILOT_SPEED_UP": 250,
    "PSC_ACCZ_I": 1.0,
    "PSC_ACCZ_P": 0.5,
    "PSC_JERK_XY": 5.0,
    "PSC_JERK_Z": 5.0,
    "PSC_POSXY_P": 1.0,
    "PSC_POSZ_P": 1.0,
    "PSC_VELXY_D": 0.25,
    "PSC_VELXY_I": 1.0,
    "PSC_VELXY_P": 2.0,
    "PSC_VELZ_P": 5.0,
    "RTL_ALT": 1500,
    "SCHED_LOOP_RATE": 400,
    "SERIAL0_BAUD": 115,
    "SERIAL1_BAUD": 57,
    "SERIAL2_BAUD": 57,
    "SR0_EXTRA1": 0,
    "SR0_RAW_SENS": 0,
    "SYSID_THISMAV": 1,
    "WPNAV_ACCEL": 250.0,
    "WPNAV_ACCEL_Z": 100.0,
    "WPNAV_SPEED": 1000.0,
    "WPNAV_SPEED_DN": 150.0,
    "WPNAV_SPEED_UP": 250.0,
    "WP_YAW_BEHAVIOR": 2,
}
"""Copter's defaults in Copter's units, but for the motors: the simulated ESCs bend no thrust curve."""

_INT16 = frozenset({"ANGLE_MAX", "LAND_SPEED", "MOT_PWM_MAX", "MOT_PWM_MIN", "PILOT_SPEED_UP", "SCHED_LOOP_RATE",
                    "SR0_EXTRA1", "SR0_RAW_SENS", "SYSID_THISMAV", "INS_GYRO_FILTER"})  # fmt: skip
_INT32 = frozenset({"ARMING_CHECK", "GUID_OPTIONS", "RTL_ALT", "SERIAL0_BAUD", "SERIAL1_BAUD", "SERIAL2_BAUD"})

# What flies is the same loops as behind PX4's face: their parameter, and its unit over Copter's.
_LOOPS: Mapping[str, tuple[tuple[str, ...], float]] = {
    "ANGLE_MAX": (("MPC_TILTMAX_AIR",), 0.01),
    "DISARM_DELAY": (("COM_DISARM_PRFLT",), 1.0),
    "LAND_SPEED": (("MPC_LAND_SPEED",), 0.01),
    "MOT_THST_HOVER": (("MPC_THR_HOVER",), 1.0),
    "PSC_POSXY_P": (("MPC_XY_P",), 1.0),
    "PSC_POSZ_P": (("MPC_Z_P",), 1.0),
    "PSC_VELXY_D": (("MPC_XY_VEL_D_ACC",), 1.0),
    "PSC_VELXY_I": (("MPC_XY_VEL_I_ACC",), 1.0),
    "PSC_VELXY_P": (("MPC_XY_VEL_P_ACC",), 1.0),
    "PSC_VELZ_P": (("MPC_Z_VEL_P_ACC",), 1.0),
    "RTL_ALT": (("RTL_RETURN_ALT",), 0.01),
    "WPNAV_SPEED": (("MPC_XY_CRUISE",), 0.01),
    "WPNAV_SPEED_DN": (("MPC_Z_V_AUTO_DN",), 0.01),
    "WPNAV_SPEED_UP": (("MPC_Z_V_AUTO_UP", "MPC_TKO_SPEED"), 0.01),
}
# Copter does not limit the velocities that it is told, disarms soon after a landing, and lands in one stage.
_FIXED: Mapping[str, float] = {
    "COM_DISARM_LAND": 1.0,
    "MPC_XY_VEL_MAX": 20.0,
    "MPC_Z_VEL_MAX_DN": 5.0,
    "MPC_Z_VEL_MAX_UP": 5.0,
}


class CopterParameters(ParameterTable):
    """Copter's parameters; those of the control loops act on `loops`.

    Parameters
    ----------
    changes : mapping
        Values other than the defaults, in Copter's units.

    Raises
    ------
    KeyError
        If a name is unknown or a value not finite.
    """

    def __init__(self, changes: Mapping[str, float] | None = None) -> None:
        self.loops = Px4Parameters(_FIXED)
        """What the control loops obey."""
        super().__init__(DEFAULTS, changes)
        for name in _LOOPS:
            self._pass_on(name)

    def bits(self, name: str) -> int:
        """Size of a whole number's type."""
        return 32 if name in _INT32 else 16 if name in _INT16 else 8

    def set(self, name: str, value: float) -> bool:
        """Set a value; False if the name is unknown, or the value not finite or beyond the type."""
        known = super().set(name, value)
        if known:
            self._pass_on(name)
        return known

    def _pass_on(self, name: str) -> None:
        names, factor = _LOOPS.get(name, ((), 1.0))
        for of_loop in names:
            self.loops.set(of_loop, self[name] * factor)
