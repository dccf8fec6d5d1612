"""Thrust from the commanded throttle or the motor outputs, the voltage, and a slow calibration in quiet hover."""

import math
from dataclasses import dataclass

from swingd.core.swing_ekf import GRAVITY_MPS2
from swingd.model.events import Battery, Motors, Throttle
from swingd.model.parameters import Parameters, ThrustSource

FRESH_S = 0.3
"""A source that is older than this is not used."""
QUIET_AFTER_S = 1.0
"""Hover must have been quiet for this long before it calibrates."""
FAST_S = 0.4
"""Time constant of the thrust against weight that is watched for steps."""
SETTLE_S = 2.0
"""Quiet time before the first hover is taken as the reference against which steps are seen."""
STEP = 0.08
"""A change of thrust against weight beyond this is a change of the load, not of the calibration."""


class _LaggedOutputs:
    """Curve of the mean over motors behind a first-order lag on each output."""

    def __init__(self, parameters: Parameters, delay_s: float) -> None:
        thrust = parameters.thrust
        self._a, self._b, self._c = thrust.quadratic_n, thrust.linear_n, thrust.offset_n
        self._tau_s = thrust.motor_time_constant_s
        self._delay_s = delay_s
        self._t_s = math.nan
        self._commanded: tuple[float, ...] = ()
        self._turning: list[float] = []

    def reset(self) -> None:
        self._t_s = math.nan

    def fresh(self, t_boot_s: float) -> bool:
        return t_boot_s - self._delay_s - self._t_s < FRESH_S

    def add(self, t_boot_s: float, outputs: tuple[float, ...]) -> None:
        if math.isnan(self._t_s) or len(outputs) != len(self._commanded) or t_boot_s - self._t_s > FRESH_S:
            self._turning = list(outputs)
        else:
            self._turning = self._at(t_boot_s)
        self._t_s, self._commanded = t_boot_s, outputs

    def curve_n(self, t_boot_s: float) -> float:
        """Thrust at nominal voltage [N]."""
        turning = self._at(t_boot_s - self._delay_s)
        total = sum(self._a * x * x + self._b * x + self._c for x in turning)
        return max(total / len(turning), 0.0)

    def _at(self, t_boot_s: float) -> list[float]:
        if self._tau_s <= 0.0:
            return list(self._commanded)
        kept = math.exp(-max(t_boot_s - self._t_s, 0.0) / self._tau_s)
        return [u + (x - u) * kept for u, x in zip(self._commanded, self._turning, strict=True)]


VOLTAGE_JUMP_SHARE = 1.0 / 3.0
VOLTAGE_JUMP_FOR_S = 10.0


@dataclass(frozen=True, slots=True)
class ThrustReading:
    """Thrust along body -z at one instant."""

    thrust_n: float
    curve_n: float
    """By curve and voltage alone, without the scale; 0 for Remark 1 [N]."""
    source: ThrustSource


class ThrustModel:
    """F = scale (V / V0)^n (a x^2 + b x + c) of the motor outputs, else of the throttle; else Remark 1."""

    def __init__(self, parameters: Parameters) -> None:
        thrust = parameters.thrust
        self._thrust = thrust
        self._mass_kg = parameters.vehicle.mass_kg
        self._payload_mass_kg = parameters.payload.mass_kg
        self._motors = _LaggedOutputs(parameters, thrust.motors_delay_s)
        self._throttle = _LaggedOutputs(parameters, thrust.throttle_delay_s)
        self._voltage_v = math.nan
        self._t_voltage_s = 0.0
        self._jumped_s: float | None = None
        self.compensated = False
        """The autopilot scales its outputs with the voltage: the throttle then means thrust, the outputs do not."""

    @property
    def voltage_v(self) -> float:
        """Low-passed voltage; the nominal one before the first reading [V]."""
        return self._thrust.voltage_nominal_v if math.isnan(self._voltage_v) else self._voltage_v

    def reset_clock(self) -> None:
        """Forget everything that carries a stamp of the autopilot's clock."""
        self._motors.reset()
        self._throttle.reset()

    def add_motors(self, motors: Motors) -> None:
        """Take motor outputs."""
        if motors.outputs:
            self._motors.add(motors.t_boot_s, motors.outputs)

    def add_throttle(self, throttle: Throttle) -> None:
        """Take a commanded throttle."""
        self._throttle.add(throttle.t_boot_s, (throttle.throttle,))

    def add_battery(self, battery: Battery) -> bool:
        """Take a voltage; return whether it was taken.

        It must be within ``voltage_min_v`` .. ``voltage_max_v``, and not far from the ones before: no pack under load
        jumps by a third. What stays there for `VOLTAGE_JUMP_FOR_S` is measured otherwise from then on, and is taken.
        """
        if not self._thrust.voltage_min_v <= battery.voltage_v <= self._thrust.voltage_max_v:
            return False
        if abs(battery.voltage_v - self.voltage_v) <= VOLTAGE_JUMP_SHARE * self.voltage_v or math.isnan(
            self._voltage_v
        ):
            self._jumped_s = None
        else:
            if self._jumped_s is None:
                self._jumped_s = battery.t_mono_s
            if battery.t_mono_s - self._jumped_s < VOLTAGE_JUMP_FOR_S:
                return False
            self._jumped_s, self._voltage_v = None, math.nan
        dt_s, self._t_voltage_s = battery.t_mono_s - self._t_voltage_s, battery.t_mono_s
        if math.isnan(self._voltage_v):
            self._voltage_v = battery.voltage_v
        else:
            tau_s = self._thrust.voltage_time_constant_s
            self._voltage_v += (1.0 - math.exp(-max(dt_s, 0.0) / max(tau_s, 1e-6))) * (
                battery.voltage_v - self._voltage_v
            )
        return True

    def source(self, t_boot_s: float) -> ThrustSource:
        """Return the best source at this instant that the configuration allows."""
        wanted = self._thrust.source
        if wanted in (ThrustSource.AUTO, ThrustSource.MOTORS) and self._motors.fresh(t_boot_s):
            return ThrustSource.MOTORS
        if wanted in (ThrustSource.AUTO, ThrustSource.THROTTLE) and self._throttle.fresh(t_boot_s):
            return ThrustSource.THROTTLE
        return ThrustSource.REMARK_1

    def read(
        self,
        t_boot_s: float,
        scale: float,
        acc_level: tuple[float, float, float],
        force_n: tuple[float, float, float],
    ) -> ThrustReading:
        """Thrust now.

        Parameters
        ----------
        t_boot_s : float
            Stamp of the inertial samples that it goes with.
        scale : float
            See `ScaleCalibration`.
        acc_level : (3,)
            Inertial acceleration of the vehicle, level frame, for Remark 1 [m/s^2].
        force_n : (3,)
            Estimated disturbance and known drag, level frame, for Remark 1 [N].
        """
        source = self.source(t_boot_s)
        if source is ThrustSource.REMARK_1:
            x, y, z = (self._mass_kg * a - f for a, f in zip(acc_level, force_n, strict=True))
            z -= (self._mass_kg + self._payload_mass_kg) * GRAVITY_MPS2
            return ThrustReading(math.sqrt(x * x + y * y + z * z), 0.0, source)
        outputs = self._motors if source is ThrustSource.MOTORS else self._throttle
        factor = 1.0
        if source is ThrustSource.MOTORS or not self.compensated:
            factor = (self.voltage_v / self._thrust.voltage_nominal_v) ** self._thrust.voltage_exponent
        curve_n = factor * outputs.curve_n(t_boot_s)
        return ThrustReading(scale * curve_n, curve_n, source)


class ScaleCalibration:
    """Slow calibration of the thrust curve against the weight in quiet hover.

    A step of thrust against weight is a change of the load: calibration then stops until `restart`, because it would
    swallow a release.
    """

    def __init__(self, parameters: Parameters) -> None:
        self._rate_per_s = parameters.thrust.scale_rate_per_s
        self._range = parameters.thrust.scale_range
        self._mass_kg = parameters.vehicle.mass_kg
        self.set_load(parameters.payload.mass_kg)
        self.scale = 1.0
        self.frozen = False
        """A step of thrust against weight was seen."""
        self._quiet_s = 0.0
        self._ratio: float | None = None
        self._reference: float | None = None

    def set_load(self, payload_mass_kg: float) -> None:
        """Take another mass of the load."""
        self._weight_kg = self._mass_kg + payload_mass_kg

    def restart(self) -> None:
        """The load was lifted anew: the next quiet hover is a new reference; the scale stays."""
        self.frozen = False
        self._quiet_s = 0.0
        self._ratio = self._reference = None

    def update(self, dt_s: float, curve_n: float, up_share: float, acc_down_mps2: float, quiet: bool) -> None:
        """Take one filter step.

        Parameters
        ----------
        dt_s : float
            Interval [s].
        curve_n : float
            Thrust by curve and voltage, unscaled [N].
        up_share : float
            Vertical share of the thrust, cos(roll) cos(pitch).
        acc_down_mps2 : float
            Inertial acceleration of the vehicle, down [m/s^2].
        quiet : bool
            The load hangs, and neither vehicle nor load moves much.
        """
        if not quiet or curve_n * up_share < 0.2 * self._weight_kg * GRAVITY_MPS2:
            self._quiet_s = 0.0
            self._ratio = None
            return
        self._quiet_s += dt_s
        ratio = self._weight_kg * (GRAVITY_MPS2 - acc_down_mps2) / (curve_n * up_share)
        if self._ratio is None:
            self._ratio = ratio
        self._ratio += dt_s / (dt_s + FAST_S) * (ratio - self._ratio)
        if self._quiet_s < QUIET_AFTER_S:
            return
        if self._reference is None:
            if self._quiet_s > SETTLE_S:
                self._reference = self._ratio
            return
        if abs(self._ratio / self._reference - 1.0) > STEP:
            self.frozen = True
        if self.frozen:
            return
        # The reference follows what drifts slowly, the voltage curve's error for one, but no step.
        self._reference += max(-1.0, min(1.0, (self._ratio - self._reference) / 0.01)) * 2.0 * self._rate_per_s * dt_s
        change = self._rate_per_s * dt_s * max(-1.0, min(1.0, (self._ratio - self.scale) / 0.01))
        self.scale = max(1.0 - self._range, min(1.0 + self._range, self.scale + change))
