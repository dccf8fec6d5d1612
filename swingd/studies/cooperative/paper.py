"""What the paper prints: design parameters of Tables 1 and 2, errors of Table 3, curves (28), (29)."""

from swingd.studies.cooperative.paper_filter import AngleNoise

SIMULATION = AngleNoise(sigma_theta=1.0e-3, sigma_phi=5.0e-4, var_theta=1.0e-3, var_phi=1.0e-3)
"""Table 1."""
EXPERIMENT = AngleNoise(sigma_theta=2.5e-2, sigma_phi=1.0e-2, var_theta=0.25, var_phi=0.20)
"""Table 2."""

UNITS = {"roll": "deg", "pitch": "deg", "yaw": "deg", "x": "m", "y": "m", "z": "m"}
"""Of the states, in the order of Table 3."""
RMSE = {"roll": 2.392, "pitch": 0.760, "yaw": 2.034, "x": 0.0271, "y": 0.0430, "z": 0.0258}
"""Table 3."""
LARGEST = {"roll": 8.363, "pitch": 2.108, "yaw": 6.811, "x": 0.1230, "y": 0.1328, "z": 0.0717}
"""Table 3, largest errors."""

CARRIER_NOMINAL_V = 16.0


def printed_thrust_n(throttle_percent: float, voltage_v: float | None = None) -> float:
    """(28), or (29) with a voltage: thrust [N] of a throttle in percent."""
    curve_n = 0.0011 * throttle_percent**2 + 0.76 * throttle_percent
    return curve_n if voltage_v is None else 0.8 * (voltage_v / CARRIER_NOMINAL_V) ** 2 * curve_n
