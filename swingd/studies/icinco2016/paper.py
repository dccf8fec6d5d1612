"""What the paper prints: Tables 1 and 2, the two tasks of section 5. It prints no figures of merit."""

MASS_KG = 0.5
LOAD_MASS_KG = MASS_KG / 4.0
ROD_LENGTH_M = 0.35
INERTIA_KG_M2 = 0.177

DT_S = 0.01
PROCESS_DENSITY = 1.0
"""Q_33 of every axis; Q_11 and Q_22 are zero."""
SENSOR_VAR = 1e-3
"""Printed as R_i = 1e3."""

TARGET_M = (8.0, 3.0)
RADIUS_M = 4.0
TORQUE_AT_S = 15.0
DURATION_S = 30.0
"""Of the figures' axes."""
