"""The motion that a shaped reference plans: what to command for it, and how the load will swing meanwhile.

Linear model of one horizontal axis as in `swingd.control.placed`, r the load's displacement ahead of the hook, a the
vehicle's acceleration, M = m + m_l:

    r'' = -(g / L) r - 2 zeta sqrt(g / L) r' - a                 the pendulum
    a   = M/m G(s) a_sp + (m_l / m)(g / L) r                     tilted thrust of M g, and the cable's pull
    a_sp = (Kp + Ki/s)(v_sp - v) - Kd a + a_ff                   the autopilot's velocity loop, and feed-forward

If the vehicle is asked for a_ff = (m a_ref - m_l (g / L) r_ref) / M + Kd G a_ref, where r_ref is the pendulum below an
acceleration a_ref, then a = G a_ref and r = G r_ref solve the equations with v_sp = v: the reference as the attitude
loop lets it through. Sent together with v_sp = G v_ref and p_sp = G p_ref, the plan leaves nothing to the autopilot's
loops and nothing to the damping law, which both act on what differs from it. The load hangs from a prescribed motion,
so the frequency that the shaper must know is sqrt(g / L): the masses decide what is commanded, not when.

The reference is taken with a lead of its own derivative, as long as the attitude loop's delay, so that G does not make
the vehicle late.
"""

import math
from dataclasses import dataclass

from swingd.control.base import Vec2
from swingd.control.placed import ATTITUDE_DAMPING, attitude_bandwidth_radps
from swingd.core.constants import GRAVITY_MPS2
from swingd.model.parameters import Parameters


def swing_frequency_radps(length_m: float) -> float:
    """Give the angular frequency of the load below a prescribed motion [rad/s]."""
    return math.sqrt(GRAVITY_MPS2 / length_m)


@dataclass(slots=True)
class _Axis:
    vel_ref_mps: float = 0.0
    vel_mps: float = 0.0
    acc_mps2: float = 0.0
    load_m: float = 0.0
    """Of the load ahead of the hook."""
    load_rate_mps: float = 0.0


class NominalMotion:
    """Vehicle and load as they follow a reference, along two fixed horizontal axes.

    Parameters
    ----------
    parameters : Parameters
        Masses, cable, the autopilot's delay and gain on acceleration, natural damping.
    """

    def __init__(self, parameters: Parameters) -> None:
        self.configure(parameters)
        self.reset((0.0, 0.0))

    def configure(self, parameters: Parameters) -> None:
        """Take other parameters; the motion goes on from where it is."""
        total_kg = parameters.vehicle.mass_kg + parameters.payload.mass_kg
        self._length_m = parameters.cable.length_m
        self._omega = swing_frequency_radps(self._length_m)
        self._damping = parameters.estimator.damping_ratio
        self._bandwidth = attitude_bandwidth_radps(parameters.autopilot)
        self._own_share = parameters.vehicle.mass_kg / total_kg
        self._pull_per_s2 = parameters.payload.mass_kg / total_kg * self._omega**2
        self._velocity_d = parameters.autopilot.velocity_d
        shaping = parameters.shaping
        # No longer than the time in which the reference's acceleration changes, or the lead would be all jerk.
        self._lead_s = min(2.0 * ATTITUDE_DAMPING / self._bandwidth, 2.0 * shaping.acc_max_mps2 / shaping.jerk_max_mps3)

    def reset(self, vel_mps: Vec2) -> None:
        """Begin at a steady velocity with the load at rest below."""
        self._axes = tuple(_Axis(vel_ref_mps=vel, vel_mps=vel) for vel in vel_mps)
        self._acc_ref: Vec2 = (0.0, 0.0)
        self._ahead_m = (self._lead_s * vel_mps[0], self._lead_s * vel_mps[1])

    def step(self, vel_mps: Vec2, acc_mps2: Vec2, jerk_mps3: Vec2, dt_s: float, *, ended: bool) -> None:
        """Follow the reference over one interval.

        Parameters
        ----------
        vel_mps, acc_mps2, jerk_mps3 : (2,)
            Reference at the end of the interval.
        dt_s : float
            Since the last step [s].
        ended : bool
            Whether the planned motion is over. What swings then in the plan is not wanted: it is let go within about a
            quarter of a period, so that the damping law takes it.
        """
        lead_s = self._lead_s
        self._acc_ref = _led(acc_mps2, jerk_mps3, lead_s)
        self._ahead_m = (lead_s * vel_mps[0], lead_s * vel_mps[1])
        vel_ref_mps = _led(vel_mps, acc_mps2, lead_s)
        kept = math.exp(-self._omega * dt_s) if ended else 1.0
        for axis, vel_ref in zip(self._axes, vel_ref_mps, strict=True):
            before = axis.acc_mps2
            axis.vel_mps, axis.acc_mps2 = _oscillate(
                axis.vel_mps,
                axis.acc_mps2,
                0.5 * (axis.vel_ref_mps + vel_ref),
                self._bandwidth,
                ATTITUDE_DAMPING,
                dt_s,
            )
            axis.vel_ref_mps = vel_ref
            hanging_m = -0.5 * (before + axis.acc_mps2) / self._omega**2
            load_m, rate_mps = _oscillate(axis.load_m, axis.load_rate_mps, hanging_m, self._omega, self._damping, dt_s)
            axis.load_m, axis.load_rate_mps = kept * load_m, kept * rate_mps

    @property
    def vel_mps(self) -> Vec2:
        """Planned velocity of the vehicle, and its velocity setpoint [m/s]."""
        n, e = self._axes
        return n.vel_mps, e.vel_mps

    @property
    def lag_m(self) -> Vec2:
        """How far the vehicle is planned to be behind the reference's position [m]."""
        n, e = (
            self._ahead(0.0, axis.vel_mps, axis.acc_mps2) - ahead_m
            for axis, ahead_m in zip(self._axes, self._ahead_m, strict=True)
        )
        return n, e

    @property
    def acc_mps2(self) -> Vec2:
        """Acceleration setpoint that makes the vehicle follow [m/s^2]."""
        n, e = (self._feed_forward(axis, acc) for axis, acc in zip(self._axes, self._acc_ref, strict=True))
        return n, e

    @property
    def direction(self) -> Vec2:
        """Planned horizontal part of the cable's unit vector."""
        n, e = self._axes
        return n.load_m / self._length_m, e.load_m / self._length_m

    @property
    def direction_rate_per_s(self) -> Vec2:
        """Its derivative [1/s]."""
        n, e = self._axes
        return n.load_rate_mps / self._length_m, e.load_rate_mps / self._length_m

    def _feed_forward(self, axis: _Axis, acc_ref: float) -> float:
        omega = self._omega
        load_acc = -omega * (omega * axis.load_m + 2.0 * self._damping * axis.load_rate_mps) - axis.acc_mps2
        load_ref = self._ahead(axis.load_m, axis.load_rate_mps, load_acc)
        return self._own_share * acc_ref - self._pull_per_s2 * load_ref + self._velocity_d * axis.acc_mps2

    def _ahead(self, value: float, rate: float, rate2: float) -> float:
        """Invert the attitude loop: its input from its output and derivatives."""
        return value + (2.0 * ATTITUDE_DAMPING * rate + rate2 / self._bandwidth) / self._bandwidth


def _led(vector: Vec2, rate: Vec2, lead_s: float) -> Vec2:
    return vector[0] + lead_s * rate[0], vector[1] + lead_s * rate[1]


def _oscillate(
    value: float, rate: float, target: float, omega: float, damping: float, dt_s: float
) -> tuple[float, float]:
    """Advance value'' = omega^2 (target - value) - 2 damping omega value', exactly for a steady target."""
    sigma = damping * omega
    damped = omega * math.sqrt(1.0 - damping * damping)
    kept = math.exp(-sigma * dt_s)
    c, s = math.cos(damped * dt_s), math.sin(damped * dt_s) / damped
    off = value - target
    return (
        target + kept * (off * c + (rate + sigma * off) * s),
        kept * (rate * c - (sigma * rate + omega * omega * off) * s),
    )
