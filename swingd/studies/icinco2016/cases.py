"""The tasks of section 5, and the compensations that are compared on them.

Not printed are the gains, the circle's frequency and centre, the torque's size and duration: chosen here, and varied by
`swingd.studies.icinco2016.variations`.
"""

from dataclasses import replace

from swingd.studies.icinco2016.flight import Compensation, Gains, Scenario

GAINS = Gains(kp=1.0, kd=2.0, kp_pitch=25.0, kd_pitch=10.0)
"""Both layers critically damped, at 1 and 5 rad/s; the weight of the load then costs 2.45 m of height without
compensation, and Figure 3 shows a vehicle asked for 3 m that stays below 1 m."""
CIRCLE_HZ = 0.1
CIRCLE_HEIGHT_M = 4.5
"""Middle of the axis of Figures 8 and 10, 0 to 9 m."""
TORQUE_NM = -0.2
"""Turns the load forward, and the vehicle's nose down; a torque that stays may not pass 0.72 m_p g l_p = 0.31 N m, or
the rod turns over and over."""
TORQUE_FOR_S = 5.0
HOOK_M = (0.05, -0.10)
"""Ahead of and below the centre of gravity."""

REGULATION = Scenario(name="regulation", gains=GAINS)
REGULATION_TORQUE = replace(REGULATION, name="regulation_torque", torque_nm=TORQUE_NM, torque_for_s=TORQUE_FOR_S)
CIRCLE_TORQUE = replace(REGULATION_TORQUE, name="circle_torque", circle_hz=CIRCLE_HZ, circle_height_m=CIRCLE_HEIGHT_M)
CIRCLE_HOOK = replace(CIRCLE_TORQUE, name="circle_hook", torque_nm=0.0, torque_for_s=0.0, hook_m=HOOK_M)
"""Not in the paper: without torque, the load turns the vehicle by its hook."""

SCENARIOS = (REGULATION, REGULATION_TORQUE, CIRCLE_TORQUE, CIRCLE_HOOK)
VARIANTS = {
    "none": Compensation(translational=False, rotational=False),
    "rotational": Compensation(translational=False, rotational=True),
    "translational": Compensation(translational=True, rotational=False),
    "both": Compensation(translational=True, rotational=True),
}
"""What is flown of each scenario."""
