"""What the vehicles' sensors say of a flight, and the cable force that follows from it, (8), (9)."""

from dataclasses import dataclass

import numpy as np

from swingd.core.constants import GRAVITY_MPS2
from swingd.core.cooperative_flight import CarrierLog
from swingd.model.estimate import FloatArray
from swingd.studies.cooperative import vehicles as v
from swingd.studies.cooperative.flight import Flight, rotations


@dataclass(frozen=True, slots=True)
class Noise:
    """Errors of the sensors, white and per sample unless said otherwise."""

    acc_mps2: float = 0.0
    """Of each axis of the accelerometer."""
    vibration_mps2: float = 0.0
    """RMS of a line on each axis of the accelerometer, as rotors out of balance give it."""
    vibration_hz: float = 22.0
    thrust_n: float = 0.0
    thrust_scale: float = 1.0
    """Thrust that the curve tells over the true one."""
    pos_m: float = 0.0
    attitude_rad: float = 0.0
    winch_m: float = 0.0


@dataclass(frozen=True, slots=True)
class Carrier:
    """One vehicle's measurements, a row for every sample."""

    hook_ned_m: FloatArray
    """(n, 3) where its tethers begin."""
    yaw_rad: FloatArray
    """(n,)"""
    acc_mps2: FloatArray
    """(n, 3) inertial acceleration, heading frame."""
    thrust_n: FloatArray
    """(n, 3) thrust, heading frame."""
    winch_m: FloatArray
    """(n,)"""

    @property
    def cable_n(self) -> FloatArray:
        """(n, 3) pull of the tethers on it: -F_s of (9), heading frame."""
        pull: FloatArray = v.MASS_KG * (self.acc_mps2 - np.array([0.0, 0.0, GRAVITY_MPS2])) - self.thrust_n
        return pull


def measure(flight: Flight, noise: Noise, seed: int) -> tuple[Carrier, ...]:
    """Read the sensors of all vehicles; the same seed gives the same noise."""
    found = []
    for index, child in enumerate(np.random.SeedSequence([seed, 1]).spawn(v.CARRIERS)):
        rng = np.random.default_rng(child)
        n = flight.t_s.size
        euler = flight.carrier(index, CarrierLog.EULER) + noise.attitude_rad * rng.standard_normal((n, 3))
        felt = flight.carrier(index, CarrierLog.SPECIFIC_FORCE) + noise.acc_mps2 * rng.standard_normal((n, 3))
        thrust = noise.thrust_scale * flight.thrust_n(index) + noise.thrust_n * rng.standard_normal(n)
        pos = flight.carrier(index, CarrierLog.POS) + noise.pos_m * rng.standard_normal((n, 3))
        winch = flight.winch_m(index) + noise.winch_m * rng.standard_normal(n)
        phase = rng.uniform(0.0, 2.0 * np.pi, 3)
        turn = 2.0 * np.pi * noise.vibration_hz * flight.t_s[:, None] + phase
        felt += np.sqrt(2.0) * noise.vibration_mps2 * np.sin(turn)
        heading = rotations(euler * np.array([1.0, 1.0, 0.0]))
        found.append(
            Carrier(
                hook_ned_m=pos + rotations(euler) @ np.array(v.HOOK_FRD_M),
                yaw_rad=euler[:, 2].copy(),
                acc_mps2=np.einsum("nij,nj->ni", heading, felt) + np.array([0.0, 0.0, GRAVITY_MPS2]),
                thrust_n=-thrust[:, None] * heading[:, :, 2],
                winch_m=winch,
            )
        )
    return tuple(found)
