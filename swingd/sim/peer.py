"""The simulated autopilot as a MAVLink peer without I/O: what PX4 v1.16 or Copter 4.7 does on its link."""

from collections import deque
from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Any

import numpy as np
from pymavlink.dialects.v20 import common as mavlink

from swingd.link import swing_message
from swingd.link.codec import Frame, Framer
from swingd.model.parameters import Parameters, SimulatedKind
from swingd.sim.autopilot import Autopilot
from swingd.sim.camera import Camera
from swingd.sim.copter import Copter
from swingd.sim.face import CompanionLog, Face, text_of
from swingd.sim.fault_effects import Direction
from swingd.sim.faults import Faults
from swingd.sim.missions import Missions
from swingd.sim.parameter_table import ParameterTable
from swingd.sim.plant import DT_S, Plant, Truth
from swingd.sim.px4 import Px4
from swingd.sim.px4_parameters import Px4Parameters
from swingd.sim.sensors import Battery, Sensors
from swingd.sim.vibration import Vibration
from swingd.sim.wire import Wire

SYSTEM_ID = 1
COMPONENT_ID = 1
GROUND_STATION_SYSTEM_ID = 255
GROUND_STATION_COMPONENT_ID = 190

_RECEIVE_DELAY_STEPS = 2  # the autopilots read their link in a thread of its own
_REBOOT_S = 3.0
_HEARTBEAT_US = 1_000_000
_LONG_AGO_US = -(10**9)

_FACES: Mapping[SimulatedKind, type[Px4] | type[Copter]] = {
    SimulatedKind.PX4: Px4,
    SimulatedKind.ARDUPILOT: Copter,
}


class SimulatedAutopilot:
    """An autopilot with a multirotor and a slung load, seen from its MAVLink link.

    Parameters
    ----------
    parameters : Parameters
        Vehicle, payload, cable, thrust curve and simulation; ``simulation.autopilot`` is what it looks like.
    autopilot_parameters : mapping, optional
        The autopilot's own parameters other than the defaults, by name, in its units.
    signing_key : bytes, optional
        32 bytes: the autopilot signs what it sends and takes what is signed only.
    signing_start_unix_s : float, optional
        Unix time of the start [s], which signatures count; 0 as of an autopilot that does not know it and takes over
        that of the first signed frame.
    without : collection of int, optional
        Ids of messages that this autopilot does not send and denies to send.

    Raises
    ------
    ConfigurationError
        If the cable cannot be simulated.
    KeyError
        If a parameter of the autopilot is unknown.
    ValueError
        If the key is not 32 bytes long.

    Notes
    -----
    Deterministic: the same parameters and the same bytes at the same times give the same frames.
    """

    def __init__(
        self,
        parameters: Parameters,
        autopilot_parameters: Mapping[str, float] | None = None,
        *,
        signing_key: bytes | None = None,
        signing_start_unix_s: float = 0.0,
        without: Collection[int] = frozenset(),
    ) -> None:
        simulation = parameters.simulation
        self.plant = Plant(parameters)
        """The truth."""
        self.faults = Faults(simulation.seed)
        """What goes wrong."""
        self.companion = CompanionLog()
        """What was received from companions."""
        make_face = _FACES[simulation.autopilot]
        self._face: Face = make_face(parameters, autopilot_parameters or {}, self.companion, self._send, without)
        self._face.reboot = self.reboot
        self._onboard = self._face.onboard
        self._sensors = Sensors(simulation)
        self._onboard.sensed = self._sensors.step(self.plant.state, self.plant.output)
        self._random = np.random.default_rng((simulation.seed, 3))
        self._early: list[bool] = []
        signing = (signing_key, signing_start_unix_s)
        self._wire = Wire(SYSTEM_ID, COMPONENT_ID, *signing, self._face.pass_unsigned)
        self._ground_station = Wire(GROUND_STATION_SYSTEM_ID, GROUND_STATION_COMPONENT_ID, *signing)
        self._camera = Camera(simulation) if simulation.camera_hz > 0.0 else None
        self._camera_wire = Wire(SYSTEM_ID, mavlink.MAV_COMP_ID_CAMERA, *signing)
        self._inbox: deque[tuple[int, Frame]] = deque()
        self._outbox: list[bytes] = []
        self._sent: list[bytes] = []
        self._entering: list[bytes] = []
        self._framer = Framer()
        self._silent_until_step = 0
        self._heartbeat_us = _LONG_AGO_US
        self._handlers: dict[int, Callable[[Frame, Any], None]] = {
            mavlink.MAVLINK_MSG_ID_TIMESYNC: self._on_timesync,
            mavlink.MAVLINK_MSG_ID_HEARTBEAT: self._on_heartbeat,
            mavlink.MAVLINK_MSG_ID_DEBUG_FLOAT_ARRAY: self._on_debug_array,
            mavlink.MAVLINK_MSG_ID_STATUSTEXT: self._on_status_text,
            **self._face.handlers(),
        }

    @property
    def t_s(self) -> float:
        """Simulated time since the start [s]; a reboot does not set it back."""
        return self._onboard.steps * DT_S

    @property
    def t_boot_s(self) -> float:
        """Simulated time since the autopilot's boot [s], which its stamps count."""
        return self._onboard.t_boot_s

    @property
    def autopilot(self) -> Autopilot:
        """Modes and control loops."""
        return self._onboard.autopilot

    @property
    def battery(self) -> Battery:
        """The pack."""
        return self._onboard.battery

    @property
    def vibration(self) -> Vibration:
        """What the rotors do to the accelerometer."""
        return self._sensors.vibration

    @property
    def parameters(self) -> ParameterTable:
        """What the PARAM protocol shows."""
        return self._face.parameters

    @property
    def px4(self) -> Px4Parameters:
        """What the control loops obey, whatever the face: PX4's parameters."""
        return self._face.loops

    @property
    def missions(self) -> Missions:
        """Missions, fences and rally points that were uploaded."""
        return self._face.missions

    @property
    def rc_channels(self) -> Sequence[int] | None:
        """Channels of the remote control [us of PWM], up to 18; None (the default): there is no remote control."""
        return self._onboard.rc_channels

    @rc_channels.setter
    def rc_channels(self, value: Sequence[int] | None) -> None:
        self._onboard.rc_channels = value

    @property
    def refused_signatures(self) -> int:
        """Frames that were not taken because they were not signed, or wrongly."""
        return self._wire.refused

    def truth(self) -> Truth:
        """Describe the present instant; its time is the autopilot's boot time."""
        return self.plant.truth(self.t_boot_s)

    def receive(self, data: bytes) -> None:
        """Take bytes from the link; they take effect when PX4 would have read them, 8 ms later. Never raises."""
        if self.faults.on_link:
            self._entering += [frame.raw for frame in self._framer.receive(data)]
        else:
            self._take(data)

    def _take(self, data: bytes) -> None:
        due = self._onboard.steps + _RECEIVE_DELAY_STEPS
        for frame in self._wire.receive(data):
            self._inbox.append((due, frame))

    def advance(self, t_s: float) -> list[bytes]:
        """Simulate up to ``t_s`` (see `t_s`) and return the frames that were sent on the way, in order."""
        target = round(t_s / DT_S)
        onboard = self._onboard
        while onboard.steps < target:
            self._step()
        frames, self._sent = self._sent, []
        return frames

    def send_to_companion(self, message: Any) -> None:
        """Put a message of pymavlink on the link as a ground station behind the autopilot would (system 255)."""
        self._outbox.append(self._ground_station.encode(message, self.t_s))

    def say_beside(self, message: Any) -> None:
        """Let that ground station send a message of pymavlink to the autopilot, which passes it on to its link."""
        frame = self._ground_station.encode(message, self.t_s)
        self._outbox.append(frame)
        self._take(frame)

    def reboot(self) -> None:
        """Restart the autopilot: silence for 3 s, then a clock from zero and default streams; parameters stay."""
        self._face.boot()
        self._silent_until_step = self._onboard.steps + round(_REBOOT_S / DT_S)
        self._inbox.clear()
        self._heartbeat_us = _LONG_AGO_US
        self._wire.restart()

    # ------------------------------------------------------------------ time

    def _step(self) -> None:
        """One IMU sample: read the link, fly, send what is due."""
        onboard, faults = self._onboard, self.faults
        faults.step(self)
        if faults.on_link or self._entering:
            entering, self._entering = self._entering, []
            for data in faults.carry(Direction.TO_AUTOPILOT, self.t_s, entering):
                self._take(data)
        onboard.steps += 1
        inbox = self._inbox
        while inbox and inbox[0][0] <= onboard.steps:
            self._handle(inbox.popleft()[1])
        early = self._is_early()
        if early:
            self._send_due()
        autopilot = onboard.autopilot
        voltage_v = onboard.battery.voltage_v
        rotors = autopilot.step(onboard.sensed)
        for effect in faults.effects:
            rotors = effect.drive(rotors)
        armed = autopilot.armed
        self.plant.step(rotors, voltage_v, spinning=armed)
        onboard.battery.step(DT_S, armed=armed)
        onboard.sensed = self._sensors.step(self.plant.state, self.plant.output)
        for effect in faults.effects:
            effect.sense(onboard.sensed)
        onboard.data_us = onboard.now_us
        if not early:
            self._send_due()
        if self._camera is not None:
            self._see(self._camera)
        leaving, self._outbox = self._outbox, []
        self._sent += faults.carry(Direction.TO_COMPANION, self.t_s, leaving) if faults.on_link else leaving

    def _send_due(self) -> None:
        """One turn of the sending thread; it sends what is due and newer than what it sent before."""
        onboard, face = self._onboard, self._face
        if onboard.steps < self._silent_until_step:
            return
        now_us = onboard.now_us
        if now_us - self._heartbeat_us >= _HEARTBEAT_US:
            self._heartbeat_us = now_us
            self._send(face.heartbeat())
        face.tick()
        for message in face.streams.due(now_us, onboard.data_us):
            self._send(message)
        face.send_queued()

    def _see(self, camera: Camera) -> None:
        """Let the camera look; the autopilot, unless it boots, passes on what it says."""
        onboard = self._onboard
        seen = camera.step(onboard.steps, self.plant.state, attached=self.plant.attached)
        if seen is not None and onboard.steps >= self._silent_until_step:
            self._outbox.append(self._camera_wire.encode(seen, self.t_s))

    def _is_early(self) -> bool:
        if not self._early:
            self._early = (self._random.random(1024) < self._face.early_probability).tolist()
        return self._early.pop()

    def _send(self, message: Any) -> None:
        for effect in self.faults.effects:
            effect.say(message)
        self._outbox.append(self._wire.encode(message, self.t_s))

    # ---------------------------------------------------------------- inputs

    def _handle(self, frame: Frame) -> None:
        handler = self._handlers.get(frame.msg_id)
        if handler is None or (frame.system_id == SYSTEM_ID and frame.component_id == COMPONENT_ID):
            return
        message = frame.message
        if message is None:
            return
        system = getattr(message, "target_system", 0)
        component = getattr(message, "target_component", 0)
        if system not in (0, SYSTEM_ID) or component not in (0, COMPONENT_ID):
            return
        if system == 0 and frame.msg_id in self._face.strangers:
            return
        handler(frame, message)

    def _on_heartbeat(self, frame: Frame, message: Any) -> None:
        self.companion.heartbeat_t_s = self.t_boot_s

    def _on_debug_array(self, frame: Frame, message: Any) -> None:
        report = swing_message.decode(message)
        if report is not None:
            self.companion.reports.append(report)

    def _on_status_text(self, frame: Frame, message: Any) -> None:
        self.companion.status_texts.append((self.t_boot_s, int(message.severity), text_of(message.text)))

    def _on_timesync(self, frame: Frame, message: Any) -> None:
        if message.tc1 == 0:
            self._send(mavlink.MAVLink_timesync_message(self._onboard.now_us * 1000, message.ts1))
