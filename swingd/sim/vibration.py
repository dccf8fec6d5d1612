"""What unbalanced rotors add to the accelerometer."""

from collections.abc import Sequence
from math import cos, pi, sin

import numpy as np

from swingd.model.events import Vec3
from swingd.model.parameters import Simulation
from swingd.sim.plant import ROTOR_SPIN

_REFERENCE_THROTTLE = 0.5
_SPEED_STD = 0.01  # two rotors at one throttle turn this differently


class Vibration:
    """Four rotors, each with an imbalance that shakes the IMU at its own speed.

    Parameters
    ----------
    simulation : Simulation
        ``vibration_mps2`` and ``vibration_hz``; ``seed`` for how the rotors differ.

    Notes
    -----
    Speed is proportional to throttle and the force to its square, as thrust is. Rotors of almost the same speed beat;
    the throttles of a vehicle that balances itself widen each line to a narrow band. Taken 250 times a second, what is
    faster than 125 Hz shows itself at another frequency, as on an autopilot that does not filter before it samples.
    """

    def __init__(self, simulation: Simulation) -> None:
        random = np.random.default_rng((simulation.seed, 4))
        self.amplitude_mps2 = simulation.vibration_mps2
        """Given to each axis at half throttle; may be changed at any time."""
        speeds = (
            2.0 * pi * simulation.vibration_hz / _REFERENCE_THROTTLE * (1.0 + _SPEED_STD * random.standard_normal(4))
        )
        self._speeds: list[float] = speeds.tolist()
        self._phases: list[float] = random.uniform(0.0, 2.0 * pi, 4).tolist()
        self._lags: list[float] = random.uniform(0.0, 2.0 * pi, 4).tolist()
        self._t_s: float | None = None

    def sample(self, t_s: float, rotors_throttle: Sequence[float]) -> Vec3:
        """Return the specific force that vibration adds at one instant, frd [m/s^2].

        Parameters
        ----------
        t_s : float
            Time of the sample, not before that of the last one.
        rotors_throttle : (4,)
            Throttle to which each rotor's present speed belongs, 0..1, in PX4's numbering.
        """
        if self.amplitude_mps2 == 0.0:
            return (0.0, 0.0, 0.0)
        # Four lines of half the amplitude have the power of one.
        amplitude = 0.5 * self.amplitude_mps2 / _REFERENCE_THROTTLE**2
        passed_s = 0.0 if self._t_s is None else t_s - self._t_s
        self._t_s = t_s
        forward = right = down = 0.0
        for i, throttle in enumerate(rotors_throttle):
            phase = (self._phases[i] + self._speeds[i] * throttle * passed_s) % (2.0 * pi)
            self._phases[i] = phase
            force = amplitude * throttle * throttle
            forward += force * cos(phase)
            right -= force * ROTOR_SPIN[i] * sin(phase)
            down += force * cos(phase + self._lags[i])
        return (forward, right, down)
