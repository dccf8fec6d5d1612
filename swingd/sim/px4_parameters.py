"""The parameters of PX4 that the simulated autopilot obeys or that a companion asks for, with PX4's defaults."""

from collections.abc import Mapping

from swingd.sim.parameter_table import ParameterTable

DEFAULTS: Mapping[str, float | int] = {
    "BAT1_N_CELLS": 4,
    "CAL_ACC0_ID": 1310988,
    "CAL_GYRO0_ID": 1310988,
    "CAL_MAG0_ID": 197388,
    "COM_DISARM_LAND": 2.0,
    "COM_DISARM_PRFLT": 10.0,
    "COM_DL_LOSS_T": 10,
    "COM_FAIL_ACT_T": 5.0,
    "COM_OBL_RC_ACT": 0,
    "COM_OF_LOSS_T": 1.0,
    "COM_RCL_EXCEPT": 0,
    "COM_RC_IN_MODE": 3,
    "COM_RC_LOSS_T": 0.5,
    "COM_SPOOLUP_TIME": 1.0,
    "HTE_HT_NOISE": 0.0036,
    "IMU_DGYRO_CUTOFF": 30.0,
    "IMU_GYRO_CUTOFF": 40.0,
    "IMU_GYRO_RATEMAX": 400,
    "IMU_INTEG_RATE": 200,
    "LNDMC_ROT_MAX": 20.0,
    "LNDMC_TRIG_TIME": 1.0,
    "LNDMC_XY_VEL_MAX": 1.5,
    "LNDMC_Z_VEL_MAX": 0.25,
    "MAV_0_RATE": 1200,
    "MAV_1_RATE": 0,
    "MAV_2_RATE": 100000,
    "MAV_COMP_ID": 1,
    "MAV_FWDEXTSP": 1,
    "MAV_SYS_ID": 1,
    "MAV_TYPE": 2,
    "MC_BAT_SCALE_EN": 0,
    "MC_PITCHRATE_D": 0.003,
    "MC_PITCHRATE_I": 0.2,
    "MC_PITCHRATE_K": 1.0,
    "MC_PITCHRATE_MAX": 220.0,
    "MC_PITCHRATE_P": 0.15,
    "MC_PITCH_P": 6.5,
    "MC_PR_INT_LIM": 0.3,
    "MC_ROLLRATE_D": 0.003,
    "MC_ROLLRATE_I": 0.2,
    "MC_ROLLRATE_K": 1.0,
    "MC_ROLLRATE_MAX": 220.0,
    "MC_ROLLRATE_P": 0.15,
    "MC_ROLL_P": 6.5,
    "MC_RR_INT_LIM": 0.3,
    "MC_YAWRATE_D": 0.0,
    "MC_YAWRATE_I": 0.1,
    "MC_YAWRATE_K": 1.0,
    "MC_YAWRATE_MAX": 200.0,
    "MC_YAWRATE_P": 0.2,
    "MC_YAW_P": 2.8,
    "MC_YAW_TQ_CUTOFF": 2.0,
    "MC_YAW_WEIGHT": 0.4,
    "MC_YR_INT_LIM": 0.3,
    "MIS_TAKEOFF_ALT": 2.5,
    "MPC_ACC_DOWN_MAX": 3.0,
    "MPC_ACC_HOR": 3.0,
    "MPC_ACC_HOR_MAX": 5.0,
    "MPC_ACC_UP_MAX": 4.0,
    "MPC_JERK_AUTO": 4.0,
    "MPC_LAND_ALT1": 10.0,
    "MPC_LAND_ALT2": 5.0,
    "MPC_LAND_SPEED": 0.7,
    "MPC_THR_HOVER": 0.5,
    "MPC_THR_MAX": 1.0,
    "MPC_THR_MIN": 0.12,
    "MPC_THR_XY_MARG": 0.3,
    "MPC_TILTMAX_AIR": 45.0,
    "MPC_TILTMAX_LND": 12.0,
    "MPC_TKO_RAMP_T": 3.0,
    "MPC_TKO_SPEED": 1.5,
    "MPC_USE_HTE": 1,
    "MPC_VELD_LP": 5.0,
    "MPC_XY_CRUISE": 5.0,
    "MPC_XY_P": 0.95,
    "MPC_XY_VEL_D_ACC": 0.2,
    "MPC_XY_VEL_I_ACC": 0.4,
    "MPC_XY_VEL_MAX": 12.0,
    "MPC_XY_VEL_P_ACC": 1.8,
    "MPC_Z_P": 1.0,
    "MPC_Z_VEL_D_ACC": 0.0,
    "MPC_Z_VEL_I_ACC": 2.0,
    "MPC_Z_VEL_MAX_DN": 1.5,
    "MPC_Z_VEL_MAX_UP": 3.0,
    "MPC_Z_VEL_P_ACC": 4.0,
    "MPC_Z_V_AUTO_DN": 1.5,
    "MPC_Z_V_AUTO_UP": 3.0,
    "NAV_DLL_ACT": 0,
    "NAV_MC_ALT_RAD": 0.8,
    "NAV_RCL_ACT": 2,
    "RTL_RETURN_ALT": 30.0,
    "SDLOG_PROFILE": 1,
    "SER_TEL1_BAUD": 57600,
    "SER_TEL2_BAUD": 921600,
    "SYS_AUTOSTART": 10016,
    "SYS_HITL": 0,
    "THR_MDL_FAC": 0.0,
}
"""An ``int`` here is an INT32 on the link, a ``float`` a REAL32."""


class Px4Parameters(ParameterTable):
    """PX4's parameters.

    Parameters
    ----------
    changes : mapping
        Values other than the defaults.

    Raises
    ------
    KeyError
        If a name is unknown or a value not finite.
    """

    def __init__(self, changes: Mapping[str, float] | None = None) -> None:
        super().__init__(DEFAULTS, changes)
