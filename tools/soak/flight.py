"""A vehicle, the whole engine, an application and a pilot on one clock, which runs as fast as the machine can."""

import math
from collections import Counter
from collections.abc import Callable
from dataclasses import asdict, replace
from time import perf_counter
from typing import Any

import psutil
from pymavlink.dialects.v20 import common as mavlink

from swingd.engine import Engine
from swingd.link.codec import Codec
from swingd.link.router import AUTOPILOT
from swingd.model.actions import Action
from swingd.model.events import Event
from swingd.model.parameters import (
    Endpoint,
    MassUse,
    Mode,
    Parameters,
    ShaperName,
    SimulatedKind,
)
from swingd.sim.autopilot import NavState
from swingd.sim.lockstep import EngineCompanion, Lockstep
from swingd.sim.peer import SimulatedAutopilot

from .record import Hour, Latency, Sample
from .watch import Watch

LOOK_S = 0.1
SAMPLE_S = 60.0
HOUR_S = 3600.0
FOLLOWS = (NavState.OFFBOARD, NavState.GUIDED)
SHAPERS = (ShaperName.NONE, ShaperName.ZV, ShaperName.ZVD, ShaperName.EI)


def parameters_of(seed: int, autopilot: SimulatedKind, estimator: str = "swing_ekf") -> Parameters:
    """What a lane flies, and what swingd believes of it; a camera sees the load where the estimator takes it."""
    parameters = Parameters()
    seen = estimator == "gp-ekf"
    return replace(
        parameters,
        estimator=replace(parameters.estimator, name=estimator),
        camera=replace(parameters.camera, source="landing_target" if seen else "none"),
        mode=Mode.INLINE,
        vehicle=replace(parameters.vehicle, drag_n_per_mps=0.35),
        payload=replace(parameters.payload, estimate_mass=MassUse.USE),
        endpoints=tuple(Endpoint(url=f"udpin://127.0.0.1:{14541 + i}", shaper=s) for i, s in enumerate(SHAPERS)),
        simulation=replace(
            parameters.simulation,
            autopilot=autopilot,
            seed=seed,
            takeoff_altitude_m=6.0,
            payload_drag_area_m2=0.006,
            battery_drain_s=600.0,
            camera_hz=15.0 if seen else 0.0,
        ),
    )


class Application:
    """Repeats one setpoint to swingd through an endpoint; nothing while ``setpoint`` is None."""

    def __init__(self, flight: "Flight", endpoint: int, system_id: int) -> None:
        self._flight = flight
        self._codec = Codec(system_id, 190)
        self.port = flight.companion.connect(flight.t_s, endpoint, system_id)
        self.setpoint: Any = None
        self.period_s = 0.05
        self._due_s = 0.0

    def step(self, t_s: float) -> None:
        """Send what is due."""
        if self.setpoint is None or t_s < self._due_s - 1e-9:
            return
        self._due_s = max(self._due_s, t_s - self.period_s) + self.period_s
        self._flight.watch.since.application_s = t_s
        self._flight.companion.application_sends(t_s, self.port, self._codec.encode(self.setpoint))

    def leave(self) -> None:
        """Disconnect."""
        self._flight.companion.disconnect(self._flight.t_s, self.port)


class Flight:
    """What one lane flies.

    Parameters
    ----------
    seed : int
        Of everything random.
    autopilot : SimulatedKind
        What it looks like.
    on_sample, on_hour : callable
        Get what is told each simulated minute and hour; nothing of it is kept.
    estimator : str
        By name.
    """

    def __init__(
        self,
        seed: int,
        autopilot: SimulatedKind,
        on_sample: Callable[[Sample], None],
        on_hour: Callable[[Hour], None],
        estimator: str = "swing_ekf",
    ) -> None:
        self.parameters = parameters_of(seed, autopilot, estimator)
        self.is_copter = autopilot is SimulatedKind.ARDUPILOT
        self.peer = SimulatedAutopilot(self.parameters)
        self.watch = Watch()
        self.engine = Engine(self.parameters, self._see)
        self.watch.attach(self.engine)
        self.engine.join(0.0)
        self.companion = EngineCompanion(self.engine)
        self.applications: list[Application] = []
        self.on_step: Callable[[float], None] = lambda _t_s: None
        """The pilot."""
        self.sorties = self.faults = 0
        self._on_sample, self._on_hour = on_sample, on_hour
        self._pilot = Codec(255, 190)
        self._process = psutil.Process()
        self._engine_latency, self._pipeline_latency = Latency(), Latency()
        self._look_s = 0.0
        self._sample_s, self._hour_s = SAMPLE_S, HOUR_S
        self._time_pipeline()
        self._lockstep = Lockstep(self.peer, self._companion, self._on_step)

    @property
    def t_s(self) -> float:
        """Simulated time since the start [s]."""
        return self.peer.t_s

    @property
    def nav_state(self) -> NavState:
        """What the autopilot flies."""
        return self.peer.autopilot.nav_state

    @property
    def follows(self) -> bool:
        """Whether the autopilot follows setpoints."""
        taking_off = self.is_copter and self.nav_state is NavState.TAKEOFF
        return self.peer.autopilot.armed and (self.nav_state in FOLLOWS or taking_off)

    def run_until(self, t_s: float) -> None:
        """Fly until the clock shows ``t_s`` [s], or the engine has failed."""
        while self.t_s < t_s - 1e-6 and self.engine.failure is None:
            self._lockstep.run_until(min(t_s, self.t_s + 1.0))

    def finish(self) -> None:
        """Tell what has not been told yet."""
        self._tell_sample()
        self._tell_hour()

    # ---- what is done to it

    def command(self, command: int, *params: float) -> None:
        """Send a command as a ground station would."""
        padded = (*params, *(0.0 for _ in range(7 - len(params))))
        self.peer.receive(self._pilot.encode(mavlink.MAVLink_command_long_message(1, 1, command, 0, *padded)))

    def connect(self, endpoint: int, system_id: int) -> Application:
        """Let an application come."""
        application = Application(self, endpoint, system_id)
        self.applications.append(application)
        return application

    def disconnect(self) -> None:
        """Let all applications go."""
        for application in self.applications:
            application.leave()
        self.applications.clear()

    def switch_correction(self, enabled: bool) -> None:
        """Use the switch, as a ground station does."""
        self.companion.deliver(self.engine.switch_correction(self.t_s, enabled))
        self.watch.since.off_s = math.inf if enabled else min(self.watch.since.off_s, self.t_s)

    def change(self, parameters: Parameters) -> None:
        """Load other parameters, as on SIGHUP."""
        parameters = replace(
            parameters, control=replace(parameters.control, enabled=self.engine.parameters.control.enabled)
        )
        self.companion.deliver(self.engine.change_parameters(self.t_s, parameters, ""))

    # ---- the loop

    def _companion(self, t_s: float, data: bytes) -> bytes:
        begin_s = perf_counter()
        answer = self.companion(t_s, data)
        self._engine_latency.add(perf_counter() - begin_s)
        self.companion.to_applications.clear()
        return answer

    def _see(self, t_s: float, action: Action) -> None:
        self.watch.see(t_s, action)

    def _time_pipeline(self) -> None:
        pipeline, add = self.engine.pipeline, self._pipeline_latency.add
        step = pipeline.step

        def timed(event: Event) -> list[Action]:
            begin_s = perf_counter()
            actions = step(event)
            add(perf_counter() - begin_s)
            return actions

        pipeline.step = timed

    def _on_step(self, t_s: float) -> None:
        if t_s >= self._look_s:
            self._look_s += LOOK_S
            faults = bool(self.peer.faults.at_work)
            self.watch.look(t_s, LOOK_S, self.peer.truth(), flying=self.follows, faults=faults)
        self.on_step(t_s)
        for application in self.applications:
            application.step(t_s)
        if t_s >= self._sample_s:
            self._sample_s += SAMPLE_S
            self._tell_sample()
        if t_s >= self._hour_s:
            self._hour_s += HOUR_S
            self._tell_hour()

    def _tell_sample(self) -> None:
        # What the simulation keeps for tests would be taken for a leak of the engine.
        self.peer.companion.reports.clear()
        engine = self.engine
        resets = engine.pipeline.resets if engine.has_joined else {}
        self._on_sample(
            Sample(
                t_s=self.t_s,
                rss_bytes=self._process.memory_info().rss,
                handles=self._process.num_fds(),
                health_s=self.watch.take_health_s(),
                resets={reason.value: count for reason, count in resets.items() if count},
                refusals=self._refusals(),
                sorties=self.sorties,
                faults=self.faults,
            )
        )

    def _tell_hour(self) -> None:
        self._on_hour(
            Hour(
                t_s=self.t_s,
                pipeline=self._pipeline_latency.take(),
                engine=self._engine_latency.take(),
                error_quiet_deg=self.watch.take_error_deg(quiet=True),
                error_faults_deg=self.watch.take_error_deg(quiet=False),
            )
        )

    def _refusals(self) -> dict[str, int]:
        """Whatever was not used, by who refused it and why."""
        engine = self.engine
        refusals: Counter[str] = Counter()
        for who, counters in (
            ("engine", engine.drops),
            ("adapter", engine.adapter.drops),
            ("router", engine.router.refusals),
        ):
            refusals.update({f"{who}: {reason.value}": count for reason, count in counters.items()})
        if engine.has_joined:
            refusals.update({f"pipeline: {what}": count for what, count in engine.pipeline.refusals.items()})
        framing = asdict(self.companion.framing(AUTOPILOT))
        refusals.update({f"framing: {what}": count for what, count in framing.items() if what != "frames"})
        return {what: count for what, count in refusals.items() if count}
