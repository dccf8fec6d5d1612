"""Frames and ticks in, frames out: what the daemon, the lockstep simulation and the replay of a recording all run."""

from __future__ import annotations

import math
from collections import Counter, deque
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from enum import Enum
from typing import TYPE_CHECKING, Any
from zlib import crc32

from pymavlink.dialects.v20 import common as mavlink

from swingd.engine.preflight import READ_IDS, Preflight
from swingd.link.adapter import AutopilotAdapter
from swingd.link.camera_reader import shows_load
from swingd.link.codec import ADDRESSED_IDS, Encoder, Frame
from swingd.link.command_server import CommandServer, RcSwitch
from swingd.link.mission_reader import MISSION_IDS, MissionReader
from swingd.link.parameter_server import ParameterServer
from swingd.link.preflight.advice import AdviceSeverity
from swingd.link.router import AUTOPILOT, Router, endpoint_of
from swingd.link.setpoints import SETPOINT_IDS
from swingd.link.status_text import StatusTextLimiter
from swingd.model.actions import (
    Action,
    Health,
    Heartbeat,
    PassSetpoint,
    Setpoint,
    Severity,
    StatusText,
    SwingReport,
)
from swingd.model.events import (
    AppSetpoint,
    AutopilotRestart,
    AutopilotState,
    CorrectionSwitch,
    Event,
    ParametersChange,
    PathCommand,
    Tick,
    VoltageCompensation,
)
from swingd.model.ground_parameters import BY_NAME, GroundParameter
from swingd.model.parameters import Mode, Parameters, ShaperName
from swingd.record.event_log import EventLogWriter

if TYPE_CHECKING:
    # The daemon forwards before the filter is loaded, and with it numpy and numba.
    from swingd.pipeline import Pipeline

TICK_S = 0.05
"""Period at which a host lets time pass."""
_LATE_SHARE = 0.5
"""Of a report's period: the grid of reports is kept although filter steps jitter."""
_HEARTBEAT_S = 1.0
_ID_AT = 7
_REPEATED_IDS = frozenset(
    {mavlink.MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED, mavlink.MAVLINK_MSG_ID_DEBUG_FLOAT_ARRAY}
)
_SAID_KEPT = 1024
"""Own frames whose checksums are kept, to know them when they come back."""
_NAMESAKE_EVERY_S = 30.0
_CHANGE_EVERY_S = 0.2
"""Between two changes of the pipeline's parameters: gains are designed anew for milliseconds each time, and whoever
sets values without end must not hold up what passes."""
_HOME_SET_S = 3.0
"""After arming home has been set, and has come."""
_COMPONENT_AT = 6
"""Of a MAVLink 2 frame, as all of swingd's own are."""

Delivery = tuple[int, bytes]
"""A port and one frame, or several, that leave through it."""

_TO_EVERYBODY = (Heartbeat, SwingReport, StatusText)
_SERVED_IDS = frozenset(
    {
        mavlink.MAVLINK_MSG_ID_PARAM_REQUEST_LIST,
        mavlink.MAVLINK_MSG_ID_PARAM_REQUEST_READ,
        mavlink.MAVLINK_MSG_ID_PARAM_SET,
        mavlink.MAVLINK_MSG_ID_COMMAND_LONG,
        mavlink.MAVLINK_MSG_ID_COMMAND_INT,
    }
)
"""What swingd answers as a component of its own."""
_CONCERNING_IDS = ADDRESSED_IDS | {mavlink.MAVLINK_MSG_ID_TIMESYNC, mavlink.MAVLINK_MSG_ID_LANDING_TARGET}
"""What may be for swingd, or must not pass; nothing else needs to be looked at."""


class Drop(Enum):
    """Why a frame was neither forwarded nor used."""

    ECHO = "echo"
    """swingd's own frame, come back."""
    IMPERSONATION = "impersonation"
    """From an endpoint, under the autopilot's name."""
    SIGNING_KEY = "signing_key"
    """SETUP_SIGNING holds a secret and is meant for the link that it is sent on; MAVLink forbids to forward it."""


class Engine:
    """The router, the autopilot's adapter, and a pipeline once it has joined.

    Until then everything is forwarded, and nothing is estimated nor corrected.

    Parameters
    ----------
    parameters : Parameters
        Everything that it needs to know.
    on_action : callable, optional
        Sees every action of the pipeline, with the host's time, before it becomes messages.
    log : EventLogWriter, optional
        Gets every input before it takes effect, and every frame of swingd's own that is answered.
    signing : bool, optional
        Whether what leaves through the autopilot's port will be signed; by default where ``link.key_file`` names a key.
    on_set : callable, optional
        Gets all parameters and the one that a ground station has just set.
    on_passed : callable, optional
        Gets what passes from the autopilot to the endpoints at once, so that nobody waits for the filter; `receive`
        then returns only what remains.
    """

    def __init__(
        self,
        parameters: Parameters,
        on_action: Callable[[float, Action], None] | None = None,
        log: EventLogWriter | None = None,
        signing: bool | None = None,
        on_set: Callable[[Parameters, GroundParameter], None] | None = None,
        on_passed: Callable[[list[Delivery]], None] | None = None,
    ) -> None:
        self.adapter = AutopilotAdapter(parameters.link, parameters.thrust)
        self.router = Router()
        self.drops: Counter[Drop] = Counter()
        """Frames that were neither forwarded nor used, by reason."""
        self._parameters = parameters
        self._pipeline: Pipeline | None = None
        self.failure: str | None = None
        """What ended the pipeline; None while nothing has."""
        self._said: deque[int] = deque(maxlen=_SAID_KEPT)
        self._namesake_s = -_NAMESAKE_EVERY_S
        self._targets_told: set[int] = set()
        self._on_action = on_action
        self._log = log
        self._signing = parameters.link.key_file != "none" if signing is None else signing
        self._on_set = on_set
        self._on_passed = on_passed
        link = parameters.link
        self._parameter_server = ParameterServer(parameters, link.system_id or 1, link.component_id)
        self._command_server = CommandServer(link.system_id or 1, link.component_id)
        self._rc_switch = RcSwitch(link.rc_channel)
        self._texts = StatusTextLimiter()
        self._preflight = Preflight()
        self._mission = MissionReader(link.component_id)
        self._armed = False
        self._changed_s = -math.inf
        self._change_waits = False
        self._compensated: bool | None = None
        self._signing_demanded = False
        self._encoders: dict[int, Encoder] = {}
        self._report_due_s = 0.0
        self._heartbeat_s = -_HEARTBEAT_S

    @property
    def parameters(self) -> Parameters:
        """What holds now."""
        return self._parameters

    @property
    def pipeline(self) -> Pipeline:
        """The pipeline that has joined.

        Raises
        ------
        AttributeError
            If none has.
        """
        if self._pipeline is None:
            raise AttributeError("no pipeline has joined the engine yet")
        return self._pipeline

    @property
    def has_joined(self) -> bool:
        """Whether a pipeline has joined, and no fault has ended it."""
        return self._pipeline is not None

    # ---- inputs

    def receive(self, t_mono_s: float, port: int, frames: Sequence[Frame]) -> list[Delivery]:
        """Take frames that came through a port; return what leaves, in order.

        Parameters
        ----------
        t_mono_s : float
            The host's monotonic clock at their arrival [s].
        port : int
            `AUTOPILOT`, or one that was opened.
        frames : sequence of Frame
            As they came, those of refused senders left out.
        """
        if self._log is not None:
            self._log.received(port, t_mono_s, b"".join([frame.raw for frame in frames]))
        out: list[Delivery] = []
        autopilot_side = port == AUTOPILOT
        for frame in frames:
            if self._is_own(frame):
                if crc32(frame.raw) in self._said:
                    self.drops[Drop.ECHO] += 1
                    continue
                self._warn_of_namesake(t_mono_s, out)
            if autopilot_side:
                if frame.signed and not self._signing and self._is_autopilot(frame):
                    self._demand_signing(t_mono_s, out)
            elif self._is_autopilot(frame):
                self.drops[Drop.IMPERSONATION] += 1
                continue
            # Most frames are telemetry: asking of each whether it is for swingd would cost more than to route it.
            if frame.msg_id in _CONCERNING_IDS and self._keeps(t_mono_s, port, frame, out):
                continue
            raw = frame.raw
            out += [(to, raw) for to in self.router.route(port, frame)]
        if autopilot_side:
            if out and self._on_passed is not None:
                self._on_passed(self._sent(t_mono_s, out))
                out = []
            self._listen(t_mono_s, frames, out)
        return self._sent(t_mono_s, out)

    def _keeps(self, t_mono_s: float, port: int, frame: Frame, out: list[Delivery]) -> bool:
        """Serve a frame as far as it is swingd's business; return whether it is to go no further."""
        if frame.msg_id in _SERVED_IDS:
            self._serve(t_mono_s, port, frame, out)
        if self._is_for_swingd(frame):
            self.router.learn(port, frame)
            if port != AUTOPILOT:
                # A reference of mode hold; what comes from the autopilot's side is taken with the rest of it.
                self._listen(t_mono_s, (frame,), out)
            return True
        if port != AUTOPILOT and frame.msg_id in SETPOINT_IDS and self._is_met(t_mono_s, port, frame, out):
            self.router.learn(port, frame)
            return True
        if shows_load(frame, self._parameters.camera, self._system_id):
            sighting = self.adapter.sighting(t_mono_s, frame)
            if sighting is not None:
                self._step(sighting, out)
            # The autopilot would take the load for a place to land on.
            out += [(to, frame.raw) for to in self.router.route(port, frame) if to != AUTOPILOT]
            return True
        if frame.msg_id == mavlink.MAVLINK_MSG_ID_LANDING_TARGET:
            self._tell_of_target(t_mono_s, frame, out)
        if frame.msg_id == mavlink.MAVLINK_MSG_ID_SETUP_SIGNING:
            self.drops[Drop.SIGNING_KEY] += 1
            return True
        return False

    def tick(self, t_mono_s: float) -> list[Delivery]:
        """Let time pass; to be called every `TICK_S`."""
        if self._log is not None:
            self._log.tick(t_mono_s)
        out: list[Delivery] = []
        if self._pipeline is None and t_mono_s - self._heartbeat_s >= _HEARTBEAT_S:
            self._heartbeat_s = t_mono_s
            self._act(t_mono_s, Heartbeat(Health.INIT if self.failure is None else Health.FAULT), out)
        self._take_change(t_mono_s, out)
        self._step(Tick(t_mono_s), out)
        for text in self._texts.tick(t_mono_s):
            self._say(self.adapter.messages(text), self.router.ports, out)
        self._say(self._parameter_server.tick(), self.router.ports, out)
        self._say(self.adapter.tick(t_mono_s), (AUTOPILOT,), out)
        self._check_autopilot(t_mono_s, out)
        if self._reads_mission and self._pipeline is not None:
            self._say(self._mission.tick(t_mono_s, self.adapter.autopilot), (AUTOPILOT,), out)
            mission = self._mission.read(t_mono_s, self.adapter.view)
            if mission is not None:
                self._step(mission, out)
        return self._sent(t_mono_s, out)

    @property
    def _reads_mission(self) -> bool:
        return self._parameters.mode is Mode.PATH and self._parameters.path.source == "mission"

    def tell(self, t_mono_s: float, message: Any) -> list[Delivery]:
        """Send a message of the host's, such as the state of its computer, to everybody; pymavlink's object."""
        if self._log is not None:
            link = self._parameters.link
            self._log.message(t_mono_s, Encoder(self._system_id, link.component_id).encode(message))
        out: list[Delivery] = []
        self._say((message,), self.router.ports, out)
        return self._sent(t_mono_s, out)

    def open_port(self, t_mono_s: float, port: int) -> None:
        """A peer behind an endpoint is there."""
        if self._log is not None:
            self._log.port(t_mono_s, port, present=True)
        self.router.open(port)

    def close_port(self, t_mono_s: float, port: int) -> None:
        """A peer behind an endpoint is gone."""
        if self._log is not None:
            self._log.port(t_mono_s, port, present=False)
        self.router.close(port)
        self._encoders.pop(port, None)

    def join(self, t_mono_s: float) -> None:
        """Begin to estimate; takes seconds where the filter has not been loaded before, in a thread for example."""
        from swingd.pipeline import Pipeline

        if self._log is not None:
            self._log.join(t_mono_s)
        self._pipeline = Pipeline(self._parameters)

    def switch_correction(self, t_mono_s: float, enabled: bool) -> list[Delivery]:
        """Enable or disable the correction."""
        if self._log is not None:
            self._log.correction(t_mono_s, enabled)
        out: list[Delivery] = []
        self._switch(t_mono_s, enabled, out)
        return self._sent(t_mono_s, out)

    def change_parameters(self, t_mono_s: float, parameters: Parameters, text: str) -> list[Delivery]:
        """Go on with other parameters on the same links; ``text`` is what a log keeps of them."""
        if self._log is not None:
            self._log.parameters(t_mono_s, text)
        out: list[Delivery] = []
        self._parameter_server.configure(parameters)
        self._change(t_mono_s, parameters, out)
        return self._sent(t_mono_s, out)

    # ---- the autopilot

    def _listen(self, t_mono_s: float, frames: Sequence[Frame], out: list[Delivery]) -> None:
        """Take what the autopilot itself says."""
        for event in self.adapter.take(t_mono_s, frames):
            if isinstance(event, AutopilotRestart):
                self._preflight.restart()
                self._mission.want()
            elif isinstance(event, AutopilotState):
                if event.armed and not self._armed:
                    # Whatever link it was uploaded through, and from where home then is.
                    self._mission.want(t_mono_s + _HOME_SET_S)
                self._armed = event.armed
            self._step(event, out)
        for frame in frames:
            if frame.msg_id in READ_IDS and self._is_autopilot(frame):
                self._preflight.take(frame)
            elif frame.msg_id in MISSION_IDS and self._reads_mission and self._is_autopilot(frame):
                autopilot = self.adapter.autopilot
                assert autopilot is not None
                self._say(self._mission.take(t_mono_s, autopilot, frame), (AUTOPILOT,), out)
            elif frame.msg_id == mavlink.MAVLINK_MSG_ID_RC_CHANNELS and self._is_autopilot(frame):
                enabled = self._rc_switch.handle(frame)
                if enabled is not None:
                    self._switch(t_mono_s, enabled, out)

    def _check_autopilot(self, t_mono_s: float, out: list[Delivery]) -> None:
        """Read the autopilot's parameters, take over what the estimate depends on, and say what is dangerous."""
        self._say(self._preflight.tick(t_mono_s, self.adapter.autopilot), (AUTOPILOT,), out)
        compensated = self._preflight.voltage_compensated
        if self._pipeline is not None and compensated is not None and compensated is not self._compensated:
            self._compensated = compensated
            self._step(VoltageCompensation(t_mono_s, compensated), out)
        if self._pipeline is None:  # not there yet, or ended by a fault just now
            return
        advice = self._preflight.judge(self._parameters, self._pipeline.rates_hz)
        if not advice:
            return
        for one in advice:
            if one.severity is AdviceSeverity.DANGER:
                self._act(
                    t_mono_s, StatusText(Severity.WARNING, f"preflight: {one.name} is {one.value}; {one.remedy}"), out
                )
        text = f"{len(advice)} findings in the autopilot's parameters; swingd doctor explains them"
        self._act(t_mono_s, StatusText(Severity.NOTICE, text), out)

    # ---- ground stations

    def _serve(self, t_mono_s: float, port: int, frame: Frame, out: list[Delivery]) -> None:
        """Answer what is asked of swingd itself."""
        self._parameter_server.system_id = self._command_server.system_id = self._system_id
        self._command_server.leads = self._parameters.mode is Mode.PATH
        answer = self._command_server.handle(t_mono_s, frame)
        if answer.switch is not None:
            self._switch(t_mono_s, answer.switch, out)
        if answer.order is not None:
            self._step(PathCommand(t_mono_s, answer.order), out)
        self._say(answer.messages, (port,), out)
        reply = self._parameter_server.handle(t_mono_s, frame)
        for message in reply.messages:
            # A value concerns everybody; an error only who asked.
            is_value = message.get_msgId() == mavlink.MAVLINK_MSG_ID_PARAM_VALUE
            self._say((message,), self.router.ports if is_value else (port,), out)
        if reply.changed is not None and reply.parameter is not None:
            self._change(t_mono_s, reply.changed, out)
            if self._on_set is not None:
                self._on_set(reply.changed, reply.parameter)
        if reply.notice is not None:
            self._act(t_mono_s, StatusText(Severity.NOTICE, reply.notice), out)
        for refusal in (answer.refusal, reply.refusal):
            if refusal is not None:
                self._act(t_mono_s, StatusText(Severity.WARNING, refusal), out)

    def _switch(self, t_mono_s: float, enabled: bool, out: list[Delivery]) -> None:
        """Enable or disable the correction; the ground station sees it in its parameter."""
        self._parameters = replace(self._parameters, control=replace(self._parameters.control, enabled=enabled))
        self._parameter_server.configure(self._parameters)
        if self._on_set is not None:
            self._on_set(self._parameters, BY_NAME["SWG_ENABLE"])
        self._step(CorrectionSwitch(t_mono_s, enabled), out)

    def _change(self, t_mono_s: float, parameters: Parameters, out: list[Delivery]) -> None:
        self._parameters = parameters
        self._change_waits = True
        self._take_change(t_mono_s, out)

    def _take_change(self, t_mono_s: float, out: list[Delivery]) -> None:
        """Let the pipeline take the parameters, at once or, where they change often, the latest a little later."""
        if not self._change_waits or t_mono_s - self._changed_s < _CHANGE_EVERY_S:
            return
        self._changed_s = t_mono_s
        self._change_waits = False
        self.adapter.configure_motors(self._parameters.thrust)
        self._step(ParametersChange(t_mono_s, self._parameters), out)

    # ---- events and actions

    def _step(self, event: Event, out: list[Delivery]) -> None:
        for action in self._run(event, out):
            self._act(event.t_mono_s, action, out)

    def _run(self, event: Event, out: list[Delivery]) -> list[Action]:
        """Return what the pipeline makes of an event; a fault in it ends the correction, never the forwarding."""
        if self._pipeline is None:
            return []
        try:
            return self._pipeline.step(event)
        except Exception as error:
            self._fail(event.t_mono_s, f"{type(error).__name__}: {error}", out)
            return []

    def _fail(self, t_mono_s: float, reason: str, out: list[Delivery]) -> None:
        self.failure = reason
        self._pipeline = None
        text = f"swingd fault: {reason}; everything passes uncorrected until it is started again"
        self._act(t_mono_s, StatusText(Severity.CRITICAL, text), out)

    def _act(self, t_mono_s: float, action: Action, out: list[Delivery]) -> None:
        if self._on_action is not None:
            self._on_action(t_mono_s, action)
        if isinstance(action, SwingReport) and not self._report_is_due(action):
            return
        if isinstance(action, Setpoint) and self._signing_demanded:
            return
        ports = self.router.ports if isinstance(action, _TO_EVERYBODY) else (AUTOPILOT,)
        for said in self._texts.offer(t_mono_s, action) if isinstance(action, StatusText) else (action,):
            messages = self.adapter.messages(said)
            self._say(messages, ports, out)
            if not messages and isinstance(said, Setpoint):
                # It stands for one of the application's, which has been consumed.
                self._fail(t_mono_s, "a setpoint that cannot be sent", out)

    def _say(self, messages: Iterable[Any], ports: Sequence[int], out: list[Delivery]) -> None:
        for message in messages:
            frame = b""
            for port in ports:
                encoder = self._encoder(port)
                frame = encoder.number(frame) if frame else encoder.encode(message)
                self._said.append(crc32(frame))
                out.append((port, frame))

    def _is_met(self, t_mono_s: float, port: int, frame: Frame, out: list[Delivery]) -> bool:
        """Whether a setpoint of an application is consumed; if not it passes as it came."""
        if (
            self._pipeline is None
            or self._parameters.mode is Mode.SHADOW
            or self._signing_demanded
            or not self._is_for_autopilot(frame)
        ):
            return False
        source = port << 16 | frame.system_id << 8 | frame.component_id
        asked = self.adapter.app_setpoint(t_mono_s, frame, source, self._shaper(port))
        if asked is None:
            return False
        passes = not isinstance(asked, AppSetpoint)
        for action in self._run(asked, out):
            if isinstance(action, PassSetpoint):
                passes = True
            else:
                self._act(t_mono_s, action, out)
        # After a fault there is nobody to meet it.
        return self.has_joined and not passes

    def _shaper(self, port: int) -> ShaperName:
        endpoints = self._parameters.endpoints
        number = endpoint_of(port)
        return endpoints[number].shaper if number < len(endpoints) else ShaperName.NONE

    def _demand_signing(self, t_mono_s: float, out: list[Delivery]) -> None:
        """The autopilot signs, so it refuses what is not signed: every setpoint of swingd's would be lost."""
        if self._signing_demanded:
            return
        self._signing_demanded = True
        text = "the autopilot demands signing and link.key_file is none: setpoints pass uncorrected"
        self._act(t_mono_s, StatusText(Severity.WARNING, text), out)

    # ---- who is who

    @property
    def _system_id(self) -> int:
        return self.adapter.system_id

    def _warn_of_namesake(self, t_mono_s: float, out: list[Delivery]) -> None:
        """Somebody else speaks under swingd's name: it passes, but answers to it cannot be told apart."""
        if t_mono_s - self._namesake_s < _NAMESAKE_EVERY_S:
            return
        self._namesake_s = t_mono_s
        number = self._parameters.link.component_id
        text = f"another component {number} of this system is there; set link.component_id of one of them"
        self._act(t_mono_s, StatusText(Severity.WARNING, text), out)

    def _tell_of_target(self, t_mono_s: float, frame: Frame, out: list[Delivery]) -> None:
        """Say once of each other target that it passes: a wrong number in the configuration looks like that."""
        camera, number = self._parameters.camera, frame.message.target_num
        if camera.source == "none" or frame.system_id != self._system_id or number in self._targets_told:
            return
        self._targets_told.add(number)
        load = f"the load is camera.target_num {camera.target_num}"
        text = f"LANDING_TARGET of target {number} passes to the autopilot: {load}"
        self._act(t_mono_s, StatusText(Severity.NOTICE, text), out)

    def _is_own(self, frame: Frame) -> bool:
        return frame.component_id == self._parameters.link.component_id and frame.system_id == self._system_id

    def _is_autopilot(self, frame: Frame) -> bool:
        autopilot = self.adapter.autopilot
        return autopilot is not None and autopilot.is_sender_of(frame)

    def _is_for_autopilot(self, frame: Frame) -> bool:
        return frame.target_system in (0, self._system_id) and frame.target_component in (
            0,
            mavlink.MAV_COMP_ID_AUTOPILOT1,
        )

    def _is_for_swingd(self, frame: Frame) -> bool:
        """Whether a frame concerns nobody else; the clock's answers do not tell for whom they are."""
        if frame.msg_id == mavlink.MAVLINK_MSG_ID_TIMESYNC:
            return self.adapter.awaits_clock(frame)
        return frame.target_component == self._parameters.link.component_id and frame.target_system == self._system_id

    def _encoder(self, port: int) -> Encoder:
        encoder = self._encoders.get(port)
        if encoder is None:
            encoder = self._encoders[port] = Encoder(self._system_id, self._parameters.link.component_id)
        encoder.system_id = self._system_id
        return encoder

    def _sent(self, t_mono_s: float, out: list[Delivery]) -> list[Delivery]:
        if self._log is not None:
            for port, raw in out:
                if self.is_recorded(port, raw):
                    self._log.sent(port, t_mono_s, raw)
        return out

    def is_repeated(self, raw: bytes) -> bool:
        """Whether a frame for the autopilot is swingd's own and is said anew within hundredths of a second."""
        own = raw[_COMPONENT_AT] == self._parameters.link.component_id
        return own and raw[_ID_AT] | raw[_ID_AT + 1] << 8 in _REPEATED_IDS

    def is_recorded(self, port: int, raw: bytes) -> bool:
        """Whether a log keeps a frame that leaves: what passes to the endpoints follows from what was received."""
        return port == AUTOPILOT or raw[_COMPONENT_AT] == self._parameters.link.component_id

    def _report_is_due(self, report: SwingReport) -> bool:
        """Thin the reports out to the rate that the links are to carry."""
        rate_hz = self._parameters.link.report_rate_hz
        if rate_hz <= 0.0:
            return False
        early_s = _LATE_SHARE / self._parameters.estimator.rate_hz
        period_s = 1.0 / rate_hz
        if abs(report.t_boot_s - self._report_due_s) > 2.0 * period_s:
            self._report_due_s = report.t_boot_s
        if report.t_boot_s < self._report_due_s - early_s:
            return False
        self._report_due_s += period_s
        return True
