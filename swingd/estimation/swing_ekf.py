"""The swing EKF of Drones 2023, 7, 654 as an object with state."""

import cmath
import math

import numpy as np

from swingd.core import swing_ekf as kernels
from swingd.core import swing_ekf_parameters as parameter_kernels
from swingd.core.status import Status
from swingd.core.swing_ekf import NUM_STATES, Scheme, State
from swingd.core.swing_ekf_parameters import NUM_PARAMETERS, ModelParameter
from swingd.estimation.base import fault_of, inputs_valid
from swingd.estimation.measurement_noise import MeasurementNoise
from swingd.model.estimate import FloatArray, LearnedModel, ResetReason, SwingEstimate
from swingd.model.parameters import Integrator, Parameters

FORCE_AGE_S = 2.0
"""Age of a disturbance that was measured before the load was lifted."""
RELEARN_DOUBT = 1.0
"""Variance added to the swing when it is corrected, over the square of the correction."""
COHERENT_SIGMAS = 2.0
"""Above what wind of the configured strength feigns."""
COHERENT_PERIODS = 1.5
"""Over which a disturbance must keep the pendulum's time to be taken for the load."""
HALVINGS_MAX = 4
GATE_CLOSED = -1.0
"""A gate that every measurement exceeds: the step is a prediction."""
UNSEEN_ACC_MPS2 = 2.0
"""Deviation of the vehicle's acceleration from the one that is assumed where samples are missing: a manoeuvre that
began, or ended, unseen."""
ANGLE_NOISE_VAR = 1e-8
"""Process noise density of the angles [rad^2/s]: keeps the covariance regular, far below everything else."""
PARAMETER_MAX = math.log(1.6)
"""Length and mass are learned within this of the configured ones, as a logarithm."""
PARAMETER_WALK = 0.001
"""Random walk of what was learned [1/sqrt(s)]: a hundredth of it is open again after some minutes."""
PARAMETER_FEIGNED = (0.01, 0.04)
"""Differences of length and mass that errors of thrust, stamps and drag feign: up to here what was configured stays."""
MISFIT_LASTS_S = 0.5
"""Correlation time of what thrust, attitude and model leave unexplained."""
MISFIT_MEMORY_S = 0.5
"""Over which its size is taken."""
LEARN_SHARE_MIN = 0.05
"""Of the measurement noise, with which the model is learned where everything fits."""

KEEPS_MODEL = (ResetReason.GAP, ResetReason.CLOCK, ResetReason.SLACK, ResetReason.ATTITUDE)
"""Resets after which the same load hangs on the same cable, and nothing is wrong with what was learned of them."""

_SCHEMES = {
    Integrator.BACKWARD_EULER: Scheme.BACKWARD_EULER,
    Integrator.IMPLICIT_MIDPOINT: Scheme.IMPLICIT_MIDPOINT,
    Integrator.RK4: Scheme.RK4,
}


class _Coherence:
    """How much of a force swings with the pendulum's period: a leaky demodulation of its increments.

    The increments of a random walk are white, so that slow wind weighs nothing.
    """

    def __init__(self, mass_kg: float, payload_mass_kg: float, length_m: float) -> None:
        # Between the pendulum under a fixed hook and the one under a free vehicle; an autopilot's loop lies between.
        self.omega_radps = math.sqrt(kernels.GRAVITY_MPS2 / length_m * (1.0 + 0.5 * payload_mass_kg / mass_kg))
        self._memory_s = COHERENT_PERIODS * 2.0 * math.pi / self.omega_radps
        self.force_per_rad_n = payload_mass_kg * kernels.GRAVITY_MPS2
        self._gain = 2.0 / (self.omega_radps * self._memory_s * self.force_per_rad_n)
        self.reset()

    def reset(self) -> None:
        """Begin anew."""
        self._last: tuple[float, float] | None = None
        self._phase_rad = 0.0
        self._x, self._y = 0j, 0j

    def update(self, force_x_n: float, force_y_n: float, dt_s: float) -> None:
        """Take the force of the next instant."""
        last, self._last = self._last, (force_x_n, force_y_n)
        if last is None:
            return
        self._phase_rad = (self._phase_rad + self.omega_radps * dt_s) % (2.0 * math.pi)
        turn = cmath.exp(-1j * self._phase_rad)
        kept = math.exp(-dt_s / self._memory_s)
        self._x = kept * self._x + (force_x_n - last[0]) * turn
        self._y = kept * self._y + (force_y_n - last[1]) * turn

    def amplitude_rad(self) -> float:
        """Angle of a load that would pull like the coherent part of the force, whatever the direction."""
        return self._gain * math.hypot(abs(self._x), abs(self._y))

    def noise_rad(self, force_var: float) -> float:
        """Deviation of the amplitude that a random walk of the force feigns, of density ``force_var`` [N^2/s]."""
        return self._gain * math.sqrt(0.5 * force_var * self._memory_s)

    def swing(self) -> tuple[float, float, float, float]:
        """Return that load's angle and rate now, along x and along y [rad], [rad/s]."""
        # The increments of A cos(w t + p) sum up to i A w T / 2 exp(i p).
        turn = -1j * self._gain * cmath.exp(1j * self._phase_rad)
        x, y = turn * self._x, turn * self._y
        return x.real, -self.omega_radps * x.imag, y.real, -self.omega_radps * y.imag


def trusted(learned: float, feigned: float) -> float:
    """Return the part of a learned difference that is acted on: nothing up to ``feigned``, soon all beyond.

    The non-negative garrote of Breiman (1995): continuous, and without the lasting shrinkage of a plain threshold.
    """
    return learned * (1.0 - (feigned / learned) ** 2) if abs(learned) > feigned else 0.0


class SwingEkf:
    """Seven states: xi, zeta, their rates and the disturbance force on the vehicle, equations (8)-(13).

    Cable length and load mass are learned beside them, see `swingd.core.swing_ekf_parameters`, and the measurement
    noise follows the innovation, see `MeasurementNoise`.

    Parameters
    ----------
    parameters : Parameters
        Vehicle, payload, cable and estimator.
    """

    def __init__(self, parameters: Parameters) -> None:
        estimator = parameters.estimator
        self._mass_kg = parameters.vehicle.mass_kg
        self._payload_mass_kg = parameters.payload.mass_kg
        self._length_m = parameters.cable.length_m
        self._scheme = int(_SCHEMES[estimator.integrator])
        self._max_step_s = estimator.max_step_s
        self._nis_gate = estimator.nis_gate
        rate_var = estimator.swing_rate_noise**2
        force_var = (estimator.force_noise * self._mass_kg) ** 2
        self._Q = np.array([ANGLE_NOISE_VAR] * 2 + [rate_var] * 2 + [force_var] * 3)
        self._noise = MeasurementNoise(
            np.array([estimator.acc_noise**2] * 2 + [estimator.acc_noise_vertical**2]), estimator.acc_noise_max**2
        )
        self._P_init = np.diag(
            [estimator.swing_std_init_rad**2] * 2
            + [estimator.swing_rate_std_init_radps**2] * 2
            + [(estimator.force_std_init * self._mass_kg) ** 2] * 3
        )
        self._relearn_rad = estimator.relearn_rad
        self._coherence = _Coherence(self._mass_kg, self._payload_mass_kg, self._length_m)
        self._feigned_rad = COHERENT_SIGMAS * self._coherence.noise_rad(force_var)
        self._configured = (self._length_m, self._payload_mass_kg)
        self._p_std = (estimator.cable_length_std, estimator.payload_mass_std)
        self._learned = [0.0] * NUM_PARAMETERS
        """ln of length and mass over the configured ones, as learned."""
        self._applied = [0.0] * NUM_PARAMETERS
        """The same, as the filter is run."""
        self._P_p = np.diag(np.square(self._p_std))
        self._V = np.zeros((NUM_STATES, NUM_PARAMETERS))
        self._V_next = np.empty((NUM_STATES, NUM_PARAMETERS))
        self._innovation = np.empty(3)
        self._misfit = 1.0
        self._x = np.zeros(NUM_STATES)
        self._P = self._P_init.copy()
        self._x_next = np.empty(NUM_STATES)
        self._P_next = np.empty((NUM_STATES, NUM_STATES))
        self._force = np.array([0.0, 0.0, -(self._mass_kg + self._payload_mass_kg) * kernels.GRAVITY_MPS2])
        self._nis = np.zeros(1)
        self._gated_s = 0.0
        self.resets = dict.fromkeys(ResetReason, 0)

    def step(self, force_n: FloatArray, acc_mps2: FloatArray, dt_s: float, *, thrust_known: bool = True) -> Status:
        """Advance over one interval; see `SwingEstimator.step`."""
        if not inputs_valid(force_n, acc_mps2, dt_s):
            return Status.INPUT_INVALID
        self._force[:] = force_n
        self._learn(acc_mps2, dt_s, thrust_known)
        status = self._advance(acc_mps2, dt_s, self._nis_gate)
        if status not in (Status.OK, Status.GATED):
            self.reset(ResetReason.NUMERICS)
            return status
        self._relearn(dt_s)
        self._gated_s = self._gated_s + dt_s if status is Status.GATED else 0.0
        reason = fault_of(self._x, self._P, self._gated_s)
        if reason is not None:
            self.reset(reason)
            return Status.NOT_CONVERGED
        return status

    def coast(self, force_n: FloatArray, dt_s: float) -> None:
        """Predict over an interval without a measurement, whose inputs are a guess, and with them the swing."""
        if not inputs_valid(force_n, force_n, dt_s):
            return
        self._force[:] = force_n
        # A constant acceleration that was not seen; left out, its swing would be taken for wind, which does not fade.
        rate = UNSEEN_ACC_MPS2 / self._length_m * dt_s
        angle = 0.5 * rate * dt_s
        for i in (State.XI, State.ZETA):
            self._P[i, i] += angle**2
            self._P[i, i + 2] += angle * rate
            self._P[i + 2, i] += angle * rate
            self._P[i + 2, i + 2] += rate**2
        if self._advance(np.zeros(3), dt_s, GATE_CLOSED) not in (Status.OK, Status.GATED):
            self.reset(ResetReason.NUMERICS)
        elif (reason := fault_of(self._x, self._P, self._gated_s)) is not None:
            self.reset(reason)
        self._nis[0] = 0.0

    def estimate(self) -> SwingEstimate:
        """Return the state after the last step."""
        rate = np.empty(NUM_STATES)
        F = np.empty((NUM_STATES, NUM_STATES))
        kernels.dynamics(rate, F, self._x, self._force, self._mass_kg, self._length_m)
        h = np.empty(3)
        H = np.empty((3, NUM_STATES))
        tension_n = kernels.observation(
            h, H, self._x, self._force, self._mass_kg, self._payload_mass_kg, self._length_m
        )
        P = self._P + self._V @ self._P_p @ self._V.T
        length_m, payload_mass_kg = (c * math.exp(p) for c, p in zip(self._configured, self._learned, strict=True))
        length_std, payload_mass_std = (math.sqrt(self._P_p[i, i]) for i in ModelParameter)
        learned = LearnedModel(length_m, length_m * length_std, payload_mass_kg, payload_mass_kg * payload_mass_std)
        return SwingEstimate(
            self._x.copy(), rate[:4], P, float(self._nis[0]), tension_n, learned, self._noise.inflation
        )

    def reset(self, reason: ResetReason, force_n: tuple[float, float, float] | None = None) -> None:
        """Begin anew with the load at rest below; ``force_n`` is the disturbance where it was measured just before."""
        self.resets[reason] += 1
        self._x[:] = 0.0
        self._P[:] = self._P_init
        if force_n is not None:
            self._x[State.FORCE_X :] = force_n
            # It has wandered since; how far, its own process noise tells.
            for i in (State.FORCE_X, State.FORCE_Y):
                self._P[i, i] = min(self._P[i, i], self._Q[i] * FORCE_AGE_S)
        self._nis[0] = 0.0
        self._gated_s = 0.0
        self._coherence.reset()
        self._noise.restart()
        self._misfit = 1.0
        # A state that was assumed owes nothing to the model.
        self._V[:] = 0.0
        if reason not in KEEPS_MODEL:
            self._learned = [0.0] * NUM_PARAMETERS
            self._P_p = np.diag(np.square(self._p_std))
            self._apply([0.0] * NUM_PARAMETERS)

    def _learn(self, acc_mps2: FloatArray, dt_s: float, thrust_known: bool) -> None:
        """Let noise and model follow the innovation of this interval, before the state does."""
        relative = np.array([p - applied for p, applied in zip(self._learned, self._applied, strict=True)])
        P_p = self._P_p.copy()
        status = parameter_kernels.learn(
            relative,
            P_p,
            self._innovation,
            self._x,
            self._P,
            self._V,
            self._force,
            acc_mps2,
            max(self._misfit, LEARN_SHARE_MIN) * self._noise.R_diag,
            dt_s,
            self._mass_kg,
            self._payload_mass_kg,
            self._length_m,
            self._nis_gate,
        )
        if status not in (Status.OK, Status.GATED):
            return
        self._noise.update(self._innovation, dt_s)
        self._weigh(dt_s)
        if status == Status.GATED or not thrust_known:
            return
        self._P_p = P_p
        for i, std in enumerate(self._p_std):
            # What is not exact opens again slowly, up to what it was at the start.
            P_p[i, i] = min(P_p[i, i] + PARAMETER_WALK**2 * dt_s, std**2)
            self._learned[i] = min(max(self._applied[i] + relative[i], -PARAMETER_MAX), PARAMETER_MAX)
        acted_on = [trusted(p, feigned) for p, feigned in zip(self._learned, PARAMETER_FEIGNED, strict=True)]
        if acted_on != self._applied:
            self._x += self._V @ np.subtract(acted_on, self._applied)
            self._apply(acted_on)

    def _weigh(self, dt_s: float) -> None:
        """Choose the noise with which the model is learned from what it has left unexplained lately.

        The configured noise covers wind, sag and tilt errors at their worst; in a calm flight the innovation is a tenth
        of it, and a length that is learned no faster than the worst flight allows is learned too late. What the model
        leaves unexplained is not white: over a correlation time tau, its density is twice tau times its variance.
        """
        variance = sum(
            slow**2 / density for slow, density in zip(self._noise.slow, self._noise.R_diag.tolist(), strict=True)
        )
        blend = dt_s / (dt_s + MISFIT_MEMORY_S)
        self._misfit += blend * (2.0 * MISFIT_LASTS_S * variance / 3.0 - self._misfit)

    def _apply(self, parameters: list[float]) -> None:
        """Run the filter with these logarithms of length and mass over the configured ones."""
        self._applied = parameters
        self._length_m = self._configured[ModelParameter.LENGTH] * math.exp(parameters[ModelParameter.LENGTH])
        self._payload_mass_kg = self._configured[ModelParameter.PAYLOAD_MASS] * math.exp(
            parameters[ModelParameter.PAYLOAD_MASS]
        )

    def _relearn(self, dt_s: float) -> None:
        """Give the swing what the disturbance took from it.

        A settled filter trusts its pendulum and takes a swing that it did not see begin, that of a kicked load for one,
        for wind. Wind does not keep time: the part that stays coherent with the pendulum is the load.
        """
        coherence = self._coherence
        coherence.update(self._x[State.FORCE_X], self._x[State.FORCE_Y], dt_s)
        if self._relearn_rad <= 0.0 or coherence.amplitude_rad() < max(self._relearn_rad, self._feigned_rad):
            return
        x, x_rate, y, y_rate = coherence.swing()
        # A load ahead (zeta > 0) or to the right (xi < 0) pulls that way.
        for angle, shift, shift_rate in ((State.ZETA, x, x_rate), (State.XI, -y, -y_rate)):
            self._x[angle] += shift
            self._x[angle + 2] += shift_rate
            self._P[angle, angle] += RELEARN_DOUBT * (shift**2 + (shift_rate / coherence.omega_radps) ** 2)
            self._P[angle + 2, angle + 2] += RELEARN_DOUBT * ((shift * coherence.omega_radps) ** 2 + shift_rate**2)
        self._x[State.FORCE_X] -= x * coherence.force_per_rad_n
        self._x[State.FORCE_Y] -= y * coherence.force_per_rad_n
        coherence.reset()

    def _advance(self, acc_mps2: FloatArray, dt_s: float, nis_gate: float) -> Status:
        """Divide the interval into steps of at most ``max_step_s``, smaller ones where the implicit equations fail.

        The innovation at the start of the interval decides for all of it.
        """
        pieces = max(1, math.ceil(dt_s / self._max_step_s - 1e-6))
        halvings = 0
        done = 0
        nis = 0.0
        while done < pieces:
            status = Status(
                kernels.step(
                    self._x_next,
                    self._P_next,
                    self._nis,
                    self._x,
                    self._P,
                    self._force,
                    acc_mps2,
                    self._Q,
                    self._noise.R_diag,
                    dt_s / pieces,
                    dt_s,
                    self._mass_kg,
                    self._payload_mass_kg,
                    self._length_m,
                    nis_gate,
                    self._scheme,
                )
            )
            if status in (Status.OK, Status.GATED):
                carried = parameter_kernels.carry_sensitivity(
                    self._V_next,
                    self._V,
                    self._x,
                    self._x_next,
                    self._P_next,
                    self._force,
                    self._noise.R_diag,
                    dt_s / pieces,
                    int(status is Status.GATED),
                    self._mass_kg,
                    self._payload_mass_kg,
                    self._length_m,
                )
                if carried != Status.OK:
                    return Status(carried)
                self._V, self._V_next = self._V_next, self._V
                self._x, self._x_next = self._x_next, self._x
                self._P, self._P_next = self._P_next, self._P
                if done == 0:
                    nis = float(self._nis[0])
                    nis_gate = GATE_CLOSED if status is Status.GATED else math.inf
                done += 1
            elif halvings < HALVINGS_MAX:
                halvings += 1
                pieces, done = 2 * pieces, 2 * done
            else:
                return status
        self._nis[0] = nis
        return Status.GATED if nis_gate == GATE_CLOSED else Status.OK
