"""The payload controller of Drones 2023, 7, 654, equation (16), with the lateral sign that damps."""

import math

from swingd.control.base import Vec2
from swingd.model.parameters import Parameters


class PayloadLaw:
    """a_x = kP zeta + kD zeta', a_y = -(kP xi + kD xi').

    With xi a rotation about x, xi > 0 is a load to the left, so the lateral row needs the minus that the paper does not
    print: with a plus the lateral swing is driven.
    """

    def __init__(self, parameters: Parameters) -> None:
        self._kp = parameters.control.payload_kp_mps2_per_rad
        self._kd = parameters.control.payload_kd_mps2_per_radps

    @property
    def acts(self) -> bool:
        """Whether either gain is given."""
        return self._kp > 0.0 or self._kd > 0.0

    def acceleration(self, direction: Vec2, rate_per_s: Vec2) -> Vec2:
        """Answer one state of the swing; see `SwingLaw.acceleration`."""
        x, y = direction
        vx, vy = rate_per_s
        down = math.sqrt(max(1.0 - x * x - y * y, 1e-6))
        v_down = -(x * vx + y * vy) / down
        across2 = y * y + down * down
        zeta, zeta_rate = math.asin(max(-1.0, min(1.0, x))), vx / math.sqrt(across2)
        xi, xi_rate = math.atan2(-y, down), (y * v_down - down * vy) / across2
        return self._kp * zeta + self._kd * zeta_rate, -(self._kp * xi + self._kd * xi_rate)
