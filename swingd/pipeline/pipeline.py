"""The order of the stages: one event in, the actions it causes out."""

import math
from collections import Counter
from dataclasses import replace
from operator import attrgetter

import numpy as np

from swingd.core.level import filter_inputs, level_from_frd, swing_in_heading
from swingd.core.status import Status
from swingd.core.swing_ekf import GRAVITY_MPS2
from swingd.estimation import LoadEstimator, make_estimator
from swingd.model.actions import (
    Action,
    ClockRequest,
    Health,
    Heartbeat,
    Severity,
    StatusText,
    SwingReport,
)
from swingd.model.disturbance import DisturbanceEstimate
from swingd.model.estimate import FloatArray, ResetReason
from swingd.model.events import (
    AppSetpoint,
    Attitude,
    AutopilotRestart,
    AutopilotState,
    Battery,
    CorrectionSwitch,
    Event,
    FlightMode,
    Imu,
    Landed,
    LandedState,
    LoadSighting,
    LocalPosition,
    Mission,
    Motors,
    ParametersChange,
    PathCommand,
    RoundTrip,
    Stream,
    StreamRefused,
    Throttle,
    Tick,
    UnmetSetpoint,
    Vec3,
    VoltageCompensation,
)
from swingd.model.parameters import MassUse, Mode, Parameters, ThrustSource
from swingd.pipeline.commander import Commander, Situation
from swingd.pipeline.correction import turn
from swingd.pipeline.disturbance import DisturbanceObserver
from swingd.pipeline.envelope import Part, withheld_by
from swingd.pipeline.health import Evidence, HealthWatch, StreamState, StreamWatch
from swingd.pipeline.load_sources import CameraState, LoadSources
from swingd.pipeline.path import PathInputs, PathProgress
from swingd.pipeline.payload_mass import MassEstimate
from swingd.pipeline.payload_state import PayloadSample, PayloadState, PayloadWatch
from swingd.pipeline.sampling import AttitudeTracker, ImuInterval, ImuSampler, Tilt
from swingd.pipeline.thrust import ScaleCalibration, ThrustModel, ThrustReading

HEARTBEAT_S = 1.0
VELOCITY_AGE_MAX_S = 1.0
"""Without a velocity for longer the known drag is left to the disturbance."""
QUIET_ACC_MPS2 = 0.4
QUIET_TILT_RAD = math.radians(8.0)
QUIET_SWING_RAD = math.radians(6.0)
QUIET_SPEED_MPS = 0.7
QUIET_TIME_CONSTANT_S = 0.3
MASS_SHARE = 0.05
"""A weighed mass that is nearer to the one in use is not worth beginning anew."""
MASS_STD_SHARE = 0.15
"""A mass that is known worse is not used."""
TEXT_EVERY_S = 1.0
CAMERA_LOST_S = 3.0
_SEEN = "the camera sees the load"
LANDED_FOR_S = 1.0
"""The land detector must say so for this long."""
ESTIMATED_FROM = ("vehicle", "payload", "cable", "thrust", "estimator", "gp_ekf", "camera", "link.imu_rate_hz")
"""Parameters that the estimate and the watch over its inputs are built from."""
DISTURBANCE_FROM = tuple(f"disturbance.{name}" for name in ("source", "force_noise", "pos_noise_m", "vel_noise_mps"))
"""What the estimate of the disturbance is built from besides."""


class Pipeline:
    """Estimates the swing and corrects the setpoints; synchronous, without clock and without I/O.

    Parameters
    ----------
    parameters : Parameters
        Everything that it needs to know.
    """

    def __init__(self, parameters: Parameters) -> None:
        self.intervals = 0
        """Filter intervals taken, also those that could not be used: by it a watchdog sees progress."""
        self._t_mono_s = -math.inf
        self._heartbeat_s = -math.inf
        self._armed: bool | None = None
        self._landed = LandedState.UNKNOWN
        self._on_ground_since_s: float | None = None
        self._state_s: float | None = None
        self._parameters = parameters
        self._compensated = False
        self._commander = Commander(parameters)
        self._law_told = False
        self._distrust_told = ""
        self._load: LoadSources | None = None
        self._notes: list[str] = []
        self._camera_told = ""
        self._hanging_since_s = -math.inf
        self._attitude = AttitudeTracker()
        self._refusals: Counter[str] = Counter()
        self._build()

    def _build(self) -> None:
        """Build what estimates anew from the parameters.

        What is being commanded goes on meanwhile, the stream of setpoints, the reference, a correction that fades:
        ending it at once would make the vehicle jump, or the autopilot leave OFFBOARD.
        """
        parameters = self._parameters
        self._sampler = ImuSampler(parameters.estimator.rate_hz)
        self._thrust = ThrustModel(parameters)
        self._thrust.compensated = self._compensated
        self._calibration = ScaleCalibration(parameters)
        self._payload = PayloadWatch(parameters)
        self._mass = self._payload.mass
        self._payload_mass_kg = parameters.payload.mass_kg
        self._take_estimator(parameters)
        self._disturbance = DisturbanceObserver(parameters)
        self._streams = StreamWatch(parameters)
        self._health = HealthWatch(parameters)
        self._told: tuple[Health, str] | None = None
        self._told_s = -math.inf
        self._position: LocalPosition | None = None
        self._blind_s = 0.0
        self._estimating = False
        self._estimate = self._estimator.estimate()
        self._acc_slow = np.zeros(3)
        self._vel_level = np.zeros(3)
        self._hook_frd = np.array(parameters.vehicle.hook_frd_m)
        self._imu_frd = np.array(parameters.vehicle.imu_frd_m)
        self._rotation = np.empty((3, 3))
        self._acc_hook = np.empty(3)
        self._force = np.empty(3)
        self._angles = np.empty(6)
        self._vector = np.empty(4)

    def _take_estimator(self, parameters: Parameters) -> None:
        self._estimator = estimator = make_estimator(parameters)
        before, self._load = self._load, None
        if isinstance(estimator, LoadEstimator):
            self._load = LoadSources(parameters, estimator, before)
            if estimator.note:
                self._notes.append(estimator.note)

    @property
    def parameters(self) -> Parameters:
        """What it was built from."""
        return self._parameters

    @property
    def health(self) -> Health:
        """The state that is published."""
        if self._health.assessment.health is Health.READY and self._commander.active:
            return Health.ACTIVE
        return self._health.assessment.health

    @property
    def reason(self) -> str:
        """Why `health` is no better; empty where it is good."""
        return self._health.assessment.reason

    @property
    def rates_hz(self) -> dict[Stream, float]:
        """The streams that the autopilot is asked for [Hz]."""
        return self._streams.rates_hz

    @property
    def refusals(self) -> dict[str, int]:
        """How often an input was not used, by what it was: ``imu`` (not finite, not newer), ``voltage`` (implausible),
        ``no_attitude`` (filter steps without a fresh one), ``gated`` (measurements beyond `nis_gate`), ``sighting`` (of
        the load: gated, too late, or of a time without an attitude), ``reference``.
        """
        camera = self.camera(self._t_mono_s)
        sightings = {} if camera is None else {"sighting": camera.unused}
        return {**self._refusals, **sightings, "reference": self._commander.refused_references}

    @property
    def resets(self) -> dict[ResetReason, int]:
        """How often the estimator began anew, by reason."""
        return self._estimator.resets

    @property
    def armed(self) -> bool | None:
        """Whether the autopilot is armed; None before its first HEARTBEAT."""
        return self._armed

    @property
    def flight_mode(self) -> FlightMode:
        """The autopilot's mode, where it was reported lately."""
        return self._commander.flight_mode

    @property
    def payload(self) -> PayloadState:
        """What hangs below the vehicle."""
        return self._payload.state

    @property
    def payload_reason(self) -> str:
        """Why `payload` is what it is, in words."""
        return self._payload.reason

    @property
    def payload_mass(self) -> MassEstimate:
        """The load's mass as the flight tells it."""
        return self._payload.mass

    @property
    def correcting(self) -> bool:
        """Whether the setpoints have a correction in them, one that fades included, or lead the load."""
        return self._commander.active

    @property
    def damping(self) -> bool:
        """Whether the correction of the swing is in the setpoints, one that fades included."""
        return self._commander.damps

    @property
    def withheld_by(self) -> tuple[str, ...]:
        """Every condition that keeps the correction of the swing off, for people; empty where it may leave."""
        reasons = self._withheld_by(Part.SWING)
        return reasons if self._commander.law_acts else (*reasons, "no gains help this vehicle")

    @property
    def feed_forward_withheld_by(self) -> tuple[str, ...]:
        """The same of the feed-forward of the disturbance."""
        return self._withheld_by(Part.DISTURBANCE)

    def _withheld_by(self, part: Part) -> tuple[str, ...]:
        health = self._health.assessment.health
        return withheld_by(part, self._commander.conditions(self._evidence(), health, self.disturbance))

    @property
    def path(self) -> PathProgress | None:
        """How far mode `path` has led the load; None in any other mode."""
        return self._commander.path if self._parameters.mode is Mode.PATH else None

    @property
    def path_withheld_by(self) -> tuple[str, ...]:
        """Every condition that keeps the load from being led."""
        return self._withheld_by(Part.PATH)

    @property
    def disturbance(self) -> DisturbanceEstimate | None:
        """Force on the vehicle besides thrust and weight; None where no source is configured."""
        return self._disturbance.estimate()

    @property
    def feed_forward_mps2(self) -> tuple[float, float]:
        """Acceleration that is set against the disturbance now, north and east [m/s^2]."""
        return self._commander.feed_forward_mps2

    def inputs(self, t_mono_s: float) -> tuple[StreamState, ...]:
        """Return age and rate of every stream that is asked for, at a time of the host's monotonic clock [s]."""
        return tuple(self._streams.state(stream, t_mono_s) for stream in self._streams.rates_hz)

    def camera(self, t_mono_s: float) -> CameraState | None:
        """Return what is known of the camera at a time of the host's monotonic clock [s]; None where there is none."""
        return None if self._load is None else self._load.camera(t_mono_s)

    def step(self, event: Event) -> list[Action]:
        """Take one event; return the actions that it causes, in the order in which they are to be sent."""
        self._t_mono_s = max(self._t_mono_s, event.t_mono_s)
        self._commander.advance_clock(self._t_mono_s)
        match event:
            case Imu():
                self._streams.arrived(Stream.IMU, event.t_mono_s)
                if not self._sampler.accepts(event):
                    self._refusals["imu"] += 1
                    return []
                interval = self._sampler.add(event)
                if interval is None:
                    return []
                actions = self._filter_step(interval)
                self.intervals += 1
                return actions
            case Attitude():
                self._streams.arrived(Stream.ATTITUDE, event.t_mono_s)
                self._attitude.add(event)
                yaw_jump_rad = self._attitude.take_yaw_jump()
                if self._load is not None:
                    self._load.add_attitude(event)
                    self._load.turn(yaw_jump_rad)
                self._commander.turn(yaw_jump_rad)
                self._disturbance.turn(yaw_jump_rad)
                if self._attitude.take_tilt_jump() and self._hangs:
                    self._reset(ResetReason.ATTITUDE)
            case Throttle():
                self._streams.arrived(Stream.THROTTLE, event.t_mono_s)
                self._thrust.add_throttle(event)
            case Motors():
                self._streams.arrived(Stream.MOTORS, event.t_mono_s)
                self._thrust.add_motors(event)
            case LocalPosition():
                self._streams.arrived(Stream.LOCAL_POSITION, event.t_mono_s)
                self._position = event
                self._commander.add_position(event)
                self._disturbance.add_position(event)
                if self._load is not None:
                    self._load.add_position(event)
            case LoadSighting():
                if self._load is not None:
                    self._load.add_sighting(event)
            case Battery():
                self._streams.arrived(Stream.BATTERY, event.t_mono_s)
                if not self._thrust.add_battery(event):
                    self._refusals["voltage"] += 1
            case Tick():
                return self._tick()
            case AppSetpoint():
                return self._commander.take(event)
            case UnmetSetpoint():
                self._commander.leave(event)
            case _:
                return self._rare(event)
        return []

    def _rare(self, event: Event) -> list[Action]:
        """Take an event that changes the state of the vehicle or of swingd itself."""
        match event:
            case AutopilotState():
                if self._armed and not event.armed:
                    self._ground()
                self._armed, self._state_s = event.armed, event.t_mono_s
                self._commander.set_state(event)
            case Landed():
                self._streams.arrived(Stream.LANDED_STATE, event.t_mono_s)
                self._landed = event.state
                self._note_landed(event)
            case AutopilotRestart():
                self._sampler.reset()
                self._attitude.reset()
                self._blind_s = 0.0
                self._thrust.reset_clock()
                self._position = None
                if self._load is not None:
                    self._load.reset()
                self._disturbance.reset()
                self._commander.autopilot_restarted()
                self._streams.restarted()
                self._health.round_trip.restarted()
                self._reset(ResetReason.CLOCK)
                return [StatusText(Severity.WARNING, f"autopilot's clock stepped by {event.step_s:+.1f} s")]
            case StreamRefused():
                self._streams.refused(event.stream, event.reason)
            case RoundTrip():
                self._health.round_trip.answered(event.t_mono_s, event.round_trip_s)
            case VoltageCompensation():
                self._compensated = self._thrust.compensated = event.active
            case CorrectionSwitch():
                if self._commander.switch(event.enabled):
                    return [StatusText(Severity.NOTICE, f"correction {'on' if event.enabled else 'off'}")]
            case Mission():
                text = self._commander.set_mission(event)
                severity = Severity.WARNING if event.problem else Severity.NOTICE
                return [StatusText(severity, text)] if text else []
            case PathCommand():
                told = self._commander.order(event.order)
                return [] if told is None else [StatusText(Severity.NOTICE, told)]
            case ParametersChange():
                return self._change(event.parameters)
            case _:
                raise AssertionError(f"no stage takes {type(event).__name__}")
        return []

    def _change(self, parameters: Parameters) -> list[Action]:
        """Take other parameters; the estimate begins anew only where it depends on them."""
        before, self._parameters = self._parameters, parameters
        self._commander.configure(parameters)
        self._law_told = False
        estimated_from, disturbance_from = attrgetter(*ESTIMATED_FROM), attrgetter(*DISTURBANCE_FROM)
        if disturbance_from(before) != disturbance_from(parameters):
            self._disturbance = DisturbanceObserver(parameters)
        if estimated_from(before) == estimated_from(parameters):
            return [StatusText(Severity.NOTICE, "parameters changed")]
        resets = self._estimator.resets
        self._build()
        self._estimator.resets.update(resets)
        return [StatusText(Severity.NOTICE, "parameters changed, the estimate begins anew")]

    # ---- estimate

    def _filter_step(self, interval: ImuInterval) -> list[Action]:
        tilt = self._attitude.at(interval)
        if tilt is None:
            # Without an attitude the samples say nothing, but the time has passed.
            self._refusals["no_attitude"] += 1
            self._blind_s += interval.dt_s
            return []
        if self._blind_s > 0.0:
            interval = replace(
                interval, dt_s=interval.dt_s + self._blind_s, missing_s=interval.missing_s + self._blind_s
            )
            self._blind_s = 0.0
        if interval.dt_s > self._parameters.estimator.max_gap_s:
            if self._hangs:
                self._reset(ResetReason.GAP)
            self._commander.drop()
            self._disturbance.reset()
            return []
        thrust = self._read_inputs(interval, tilt)
        if self._load is not None:
            self._stand(self._load, interval, tilt)
        self._observe_disturbance(interval, tilt, thrust)
        told: list[Action] = []
        if self._payload.update(self._payload_sample(interval, thrust)):
            told.append(self._payload_changed())
        if self._payload.state is PayloadState.ON_GROUND:
            # What the ground carries is no force in flight.
            self._disturbance.reset()
        if self._payload.mass is not self._mass:
            told += self._mass_changed()
        hangs = self._hangs
        if hangs:
            self._advance(interval, thrust_known=thrust.source is not ThrustSource.REMARK_1)
        if self._payload.state is PayloadState.ATTACHED:
            self._calibrate(interval.dt_s, tilt, thrust.curve_n, float(self._acc_hook[2]))
        estimate = self._estimate
        swing_in_heading(
            self._angles,
            self._vector,
            estimate.x,
            estimate.x_rate,
            estimate.P,
            self._parameters.estimator.stamp_delay_s,
            tilt.level_yaw_rad,
            tilt.level_yaw_rate_radps,
        )
        if hangs:
            self._health.step(interval.dt_s, estimate.nis, float(max(self._angles[4], self._angles[5])))
        return told + self._command(interval, tilt, thrust, self._assess())

    def _read_inputs(self, interval: ImuInterval, tilt: Tilt) -> ThrustReading:
        """Fill acceleration and force of this interval, level frame; return the thrust."""
        vehicle = self._parameters.vehicle
        level_from_frd(self._rotation, tilt.roll_rad, tilt.pitch_rad, tilt.level_yaw_rad)
        position = self._position
        if position is not None and interval.t_boot_s - position.t_boot_s < VELOCITY_AGE_MAX_S:
            vel_north, vel_east, vel_down = position.vel_ned_mps
            vel_x, vel_y = turn((vel_north, vel_east), tilt.level_yaw_rad - tilt.yaw_rad)
            self._vel_level[:] = vel_x, vel_y, vel_down
        else:
            self._vel_level[:] = 0.0
        filter_inputs(
            self._acc_hook,
            self._force,
            interval.acc_frd,
            interval.gyro_frd,
            interval.gyro_rate_frd,
            self._rotation,
            self._vel_level,
            self._hook_frd,
            self._imu_frd,
            0.0,
            vehicle.mass_kg,
            vehicle.drag_n_per_mps,
            vehicle.drag_vertical_n_per_mps,
            GRAVITY_MPS2,
        )
        known_force = _vec3(self._force + self._estimate.x[4:7])
        thrust = self._thrust.read(interval.t_mean_s, self._calibration.scale, _vec3(self._acc_hook), known_force)
        self._force -= thrust.thrust_n * self._rotation[:, 2]
        return thrust

    def _stand(self, load: LoadSources, interval: ImuInterval, tilt: Tilt) -> None:
        """Tell an estimator of the load where it is: time, heading, hook."""
        hook_vel_frd = np.cross(interval.gyro_frd, self._hook_frd)
        hook, hook_vel = (_ned(self._rotation @ vector, tilt) for vector in (self._hook_frd, hook_vel_frd))
        load.stand(interval.t_boot_s, tilt.yaw_rad - tilt.level_yaw_rad, hook, hook_vel)

    def _observe_disturbance(self, interval: ImuInterval, tilt: Tilt, thrust: ThrustReading) -> None:
        if not self._disturbance.active:
            return
        self._disturbance.step(
            interval.t_boot_s,
            interval.dt_s,
            _ned(-thrust.thrust_n * self._rotation[:, 2], tilt),
            thrust_known=thrust.source is not ThrustSource.REMARK_1,
        )

    def _payload_sample(self, interval: ImuInterval, thrust: ThrustReading) -> PayloadSample:
        """What this interval shows of the load."""
        force, body_down = _vec3(self._force), _vec3(self._rotation[:, 2])
        position = self._position
        if position is not None and interval.t_boot_s - position.t_boot_s >= VELOCITY_AGE_MAX_S:
            position = None
        return PayloadSample(
            dt_s=interval.dt_s,
            force_n=force,
            lift_n=(thrust.curve_n - thrust.thrust_n) * body_down[2] - force[2],
            acc_mps2=_vec3(self._acc_hook),
            body_down=body_down,
            thrust_known=thrust.source is not ThrustSource.REMARK_1,
            landed=self._landed,
            vel_mps=None if position is None else position.vel_ned_mps,
            altitude_m=None if position is None else -position.pos_ned_m[2],
        )

    def _advance(self, interval: ImuInterval, *, thrust_known: bool) -> None:
        """Carry the estimate over one interval, the part without samples first."""
        dt_s = interval.dt_s
        if interval.missing_s > 0.0:
            self._estimator.coast(self._force, interval.missing_s)
            dt_s -= interval.missing_s
        status = self._estimator.step(self._force, self._acc_hook, dt_s, thrust_known=thrust_known)
        if status is Status.GATED:
            self._refusals["gated"] += 1
        elif status is not Status.OK:
            self._health.reset(self._t_mono_s, fault=True)
        self._estimate = self._estimator.estimate()

    def _reset(self, reason: ResetReason, force_n: Vec3 | None = None) -> None:
        self._estimator.reset(reason, force_n)
        self._estimate = self._estimator.estimate()
        self._health.reset(self._t_mono_s, fault=False)

    def _ground(self) -> None:
        """The vehicle stands or is disarmed: nothing hangs, nothing is corrected."""
        self._payload.grounded()
        self._disturbance.reset()
        self._estimating = False
        self._commander.land()
        self._reset(ResetReason.START)

    def _note_landed(self, event: Landed) -> None:
        """Believe the land detector when it has insisted: in the air a single report may be wrong."""
        if event.state is not LandedState.ON_GROUND:
            self._on_ground_since_s = None
            return
        if self._on_ground_since_s is None:
            self._on_ground_since_s = event.t_mono_s
        if (
            event.t_mono_s - self._on_ground_since_s >= LANDED_FOR_S
            and self._payload.state is not PayloadState.ON_GROUND
        ):
            self._ground()

    def _payload_changed(self) -> StatusText:
        """The load was lifted, lost or assumed."""
        if self._payload.state is PayloadState.ATTACHED:
            self._calibration.restart()
            self._reset(ResetReason.LIFT, self._payload.force_n)
        elif self._payload.state is PayloadState.UNKNOWN:
            self._reset(ResetReason.LIFT)
        elif self._estimating:
            self._reset(ResetReason.SLACK)
        self._estimating = self._hangs
        return StatusText(Severity.NOTICE, f"{self._payload.state.value}: {self._payload.reason}")

    def _mass_changed(self) -> list[Action]:
        """The load was weighed, or its mass is no longer known."""
        before, mass = self._mass, self._payload.mass
        self._mass = mass
        if mass.mass_kg is None or mass.std_kg is None:
            return [StatusText(Severity.WARNING, mass.reason)] if before.mass_kg is not None and self._hangs else []
        text = f"load {mass.mass_kg:.3g} +- {mass.std_kg:.1g} kg by thrust"
        wanted = self._parameters.payload.estimate_mass is MassUse.USE
        apart = abs(mass.mass_kg - self._payload_mass_kg) > max(2.0 * mass.std_kg, MASS_SHARE * self._payload_mass_kg)
        if wanted and apart and mass.std_kg < MASS_STD_SHARE * mass.mass_kg:
            self._use_mass(mass.mass_kg)
            text += ", now used"
        return [StatusText(Severity.NOTICE, text)]

    def _use_mass(self, mass_kg: float) -> None:
        """Estimate, calibrate and correct with another mass of the load; the estimate begins anew."""
        parameters = self._parameters
        self._payload_mass_kg = mass_kg
        weighed = replace(parameters, payload=replace(parameters.payload, mass_kg=mass_kg))
        resets = self._estimator.resets
        self._take_estimator(weighed)
        self._estimator.resets.update(resets)
        self._calibration.set_load(mass_kg)
        self._commander.configure(weighed)
        self._reset(ResetReason.PARAMETERS)

    @property
    def _hangs(self) -> bool:
        """Whether there is a swing to estimate."""
        return self._payload.state.hangs

    def _calibrate(self, dt_s: float, tilt: Tilt, curve_n: float, acc_down_mps2: float) -> None:
        blend = dt_s / (dt_s + QUIET_TIME_CONSTANT_S)
        self._acc_slow += blend * (self._acc_hook - self._acc_slow)
        x = self._estimate.x
        up_share = math.cos(tilt.roll_rad) * math.cos(tilt.pitch_rad)
        quiet = (
            curve_n > 0.0
            and self._position is not None
            and math.hypot(*self._position.vel_ned_mps) < QUIET_SPEED_MPS
            and float(np.linalg.norm(self._acc_slow)) < QUIET_ACC_MPS2
            and up_share > math.cos(QUIET_TILT_RAD)
            and math.hypot(x[0], x[1]) < QUIET_SWING_RAD
        )
        self._calibration.update(dt_s, curve_n, up_share, acc_down_mps2, quiet)

    # ---- command

    def _command(self, interval: ImuInterval, tilt: Tilt, thrust: ThrustReading, evidence: Evidence) -> list[Action]:
        """Command, and say what is estimated."""
        thrust_n = thrust.thrust_n
        x, y, x_rate, y_rate = self._vector.tolist()
        disturbance = self.disturbance
        path = self._path_inputs(tilt, thrust) if self._parameters.mode is Mode.PATH else None
        setpoint = self._commander.step(
            Situation(
                t_boot_s=interval.t_boot_s,
                dt_s=interval.dt_s,
                gap=interval.missing_s > 0.0,
                yaw_rad=tilt.yaw_rad,
                level_yaw_rad=tilt.level_yaw_rad,
                direction=(x, y),
                direction_rate_per_s=(x_rate, y_rate),
                tilt_acc_mps2=(
                    -GRAVITY_MPS2 * self._rotation[0, 2] / self._rotation[2, 2],
                    -GRAVITY_MPS2 * self._rotation[1, 2] / self._rotation[2, 2],
                ),
                evidence=evidence,
                health=self._health.assessment.health,
                taking_off=self._landed is LandedState.TAKING_OFF,
                lift_n=thrust_n * float(self._rotation[2, 2]),
                disturbance=disturbance,
                path=path,
            )
        )
        actions: list[Action] = [setpoint] if setpoint is not None else []
        actions += [StatusText(Severity.NOTICE, text) for text in self._commander.take_texts()]
        push = self._commander.push
        xi, zeta, xi_rate, zeta_rate, xi_std, zeta_std = self._angles.tolist()
        actions.append(
            SwingReport(
                t_boot_s=interval.t_boot_s,
                xi_rad=xi,
                zeta_rad=zeta,
                xi_rate_radps=xi_rate,
                zeta_rate_radps=zeta_rate,
                force_ned_n=_ned(self._estimate.x[4:7], tilt),
                xi_std_rad=xi_std,
                zeta_std_rad=zeta_std,
                thrust_n=thrust_n,
                thrust_scale=self._calibration.scale,
                nis=self._estimate.nis,
                correction_acc_ned_mps2=(*push.acc_mps2, 0.0),
                correction_vel_ned_mps=(*push.vel_mps, 0.0),
                health=self.health,
                payload_mass_kg=self._mass.mass_kg,
                payload_mass_std_kg=self._mass.std_kg,
                disturbance=disturbance,
                feed_forward_acc_ned_mps2=(*self._commander.feed_forward_mps2, 0.0),
                applied_ned_n=_ned(self._force, tilt),
                thrust_known=thrust.source is not ThrustSource.REMARK_1,
            )
        )
        return actions

    def _path_inputs(self, tilt: Tilt, thrust: ThrustReading) -> PathInputs:
        """What leading the load needs of this interval, turned from the level frame."""
        north, east, down = _ned(self._acc_hook, tilt)
        return PathInputs(
            thrust_ned_n=_ned(-thrust.thrust_n * self._rotation[:, 2], tilt),
            thrust_known=thrust.source is not ThrustSource.REMARK_1,
            specific_force_ned_mps2=(north, east, down - GRAVITY_MPS2),
            hook_ned_m=_ned(self._rotation @ self._hook_frd, tilt),
        )

    # ---- time

    def _tell_of_camera(self, now_s: float) -> list[Action]:
        """Say once that a load which hangs is not seen any more, and that it is again."""
        camera = self.camera(now_s)
        if camera is None or not self._hangs:
            self._hanging_since_s = now_s
            return []
        age_s = min(now_s - self._hanging_since_s, math.inf if camera.age_s is None else camera.age_s)
        text = f"the camera has not seen the load for {CAMERA_LOST_S:g} s" if age_s > CAMERA_LOST_S else _SEEN
        told, self._camera_told = self._camera_told, text
        return [] if text == (told or _SEEN) else [StatusText(Severity.NOTICE, text)]

    @property
    def _heartbeat_age_s(self) -> float | None:
        return None if self._state_s is None else self._t_mono_s - self._state_s

    def _evidence(self) -> Evidence:
        return self._health.evidence(self._t_mono_s, self._streams, self._payload.state, self._heartbeat_age_s)

    def _assess(self) -> Evidence:
        evidence = self._evidence()
        self._health.assess(self._t_mono_s, evidence)
        return evidence

    def _tick(self) -> list[Action]:
        now_s = self._t_mono_s
        self._assess()
        owed = self._commander.tick(self._health.assessment.health)
        actions: list[Action] = [owed] if owed is not None else []
        if self._state_s is not None:
            # Before the autopilot's first HEARTBEAT there is nobody to ask.
            actions += self._streams.tick(now_s, bool(self._armed))
        if self._streams.age_s(Stream.IMU, now_s) is not None and self._health.round_trip.request_due(now_s):
            actions.append(ClockRequest(now_s))
        if now_s - self._heartbeat_s >= HEARTBEAT_S:
            self._heartbeat_s = now_s
            actions.append(Heartbeat(self.health))
        if not self._law_told and self._state_s is not None:
            self._law_told = True
            if self._parameters.mode is not Mode.SHADOW and not self._commander.law_acts:
                actions.append(StatusText(Severity.WARNING, "no gains help this vehicle: see swingd check"))
        actions += self._tell_of_camera(now_s)
        actions += [StatusText(Severity.WARNING, note) for note in self._notes]
        self._notes.clear()
        distrust = self._commander.distrust
        if distrust != self._distrust_told:
            self._distrust_told = distrust
            if distrust:
                actions.append(StatusText(Severity.ERROR, f"correction off until enabled again: {distrust}"))
        state = (self.health, self._health.assessment.reason)
        if state != self._told and now_s - self._told_s >= TEXT_EVERY_S:
            self._told, self._told_s = state, now_s
            severity = _SEVERITIES[self.health]
            reason = f": {state[1]}" if state[1] else ""
            actions.append(StatusText(severity, f"swingd {self.health.value}{reason}"))
        return actions


_SEVERITIES = {
    Health.INIT: Severity.INFO,
    Health.READY: Severity.INFO,
    Health.ACTIVE: Severity.INFO,
    Health.DEGRADED: Severity.WARNING,
    Health.FAULT: Severity.ERROR,
}


def _ned(level: FloatArray, tilt: Tilt) -> Vec3:
    """Turn a vector of the level frame to north, east, down."""
    x, y, z = level.tolist()
    return (*turn((x, y), tilt.yaw_rad - tilt.level_yaw_rad), z)


def _vec3(array: FloatArray) -> Vec3:
    x, y, z = array.tolist()
    return x, y, z
