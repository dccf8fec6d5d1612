"""A camera that sees the load: its LANDING_TARGET becomes sightings on the autopilot's clock."""

import math
from collections import Counter, deque

from pymavlink.dialects.v20 import common as mavlink

from swingd.link.clock import RemoteClock, Verdict
from swingd.link.codec import Frame
from swingd.link.setpoints import POS_MAX_M
from swingd.link.stamps import Drop
from swingd.link.telemetry import Telemetry
from swingd.model.events import LoadSighting, SightingFrame
from swingd.model.parameters import Camera

_FRAMES = {
    mavlink.MAV_FRAME_BODY_FRD: SightingFrame.BODY_FRD,
    mavlink.MAV_FRAME_LOCAL_NED: SightingFrame.LOCAL_NED,
}
_STAMP_MAX_US = 10**16
_SENDER_SILENT_S = 2.0
"""Another camera is listened to when the first has been silent for so long."""
_STAMPS_KEPT = 32


def shows_load(frame: Frame, camera: Camera, system_id: int) -> bool:
    """Whether a frame is the LANDING_TARGET by which the load of the vehicle ``system_id`` is told."""
    return (
        camera.source == "landing_target"
        and frame.msg_id == mavlink.MAVLINK_MSG_ID_LANDING_TARGET
        and frame.system_id == system_id
        and frame.message.target_num == camera.target_num
    )


class CameraReader:
    """Reads the sightings of one camera, the first that is heard, while it goes on.

    A camera stamps its pictures by a clock of its own, boot time or unix time. That clock is tracked against the
    autopilot's newest stamp, so that a simulation that runs slowly shifts nothing: the quickest message is taken to
    have been there at once, and the others are late by as much as their stamps say. How old the quickest one was nobody
    can see; ``camera.delay_s`` tells. A stamp of 0 is none: then the message counts as taken when it came.

    Parameters
    ----------
    drops : Counter of Drop
        Counts what is not used.
    """

    def __init__(self, drops: Counter[Drop]) -> None:
        self._drops = drops
        self._sender: tuple[int, int] | None = None
        self._heard_s = -math.inf
        self._begin()

    def _begin(self) -> None:
        self._clock = RemoteClock()
        self._stamps: deque[int] = deque(maxlen=_STAMPS_KEPT)

    def take(self, t_mono_s: float, frame: Frame, telemetry: Telemetry) -> LoadSighting | None:
        """Return what a LANDING_TARGET says, or None (counted) if it is not to be used; never raises.

        Parameters
        ----------
        t_mono_s : float
            The host's monotonic clock at its arrival [s].
        frame : Frame
            LANDING_TARGET.
        telemetry : Telemetry
            Knows the autopilot's clock.
        """
        seen = self._read(t_mono_s, frame, telemetry)
        if isinstance(seen, Drop):
            self._drops[seen] += 1
            return None
        return seen

    def _read(self, t_mono_s: float, frame: Frame, telemetry: Telemetry) -> LoadSighting | Drop:
        message, sender = frame.message, (frame.system_id, frame.component_id)
        if sender != self._sender:
            if t_mono_s - self._heard_s < _SENDER_SILENT_S:
                return Drop.OTHER_SENDER
            self._sender = sender
            self._begin()
        self._heard_s = t_mono_s
        seen_as = _FRAMES.get(message.frame)
        if seen_as is None or message.position_valid != 1:
            return Drop.TARGET_FRAME
        position_m = (message.x, message.y, message.z)
        if not all(map(math.isfinite, position_m)):
            return Drop.NOT_FINITE
        if max(map(abs, position_m)) > POS_MAX_M:
            return Drop.IMPOSSIBLE
        now_s = telemetry.newest_s
        if now_s is None:
            return Drop.NO_CLOCK
        taken_s = self._time(now_s, message.time_usec)
        return taken_s if isinstance(taken_s, Drop) else LoadSighting(t_mono_s, taken_s, position_m, seen_as)

    def _time(self, now_s: float, stamp_us: int) -> float | Drop:
        """Return when the picture was taken by the autopilot's clock, which shows ``now_s`` [s]."""
        if stamp_us == 0:
            return now_s
        if stamp_us >= _STAMP_MAX_US:
            return Drop.IMPOSSIBLE
        if stamp_us in self._stamps:
            return Drop.DUPLICATE
        verdict = self._clock.judge(now_s, stamp_us * 1e-6)
        if verdict is Verdict.LATE:
            return Drop.LATE
        if verdict is Verdict.AHEAD:
            return Drop.AHEAD
        self._stamps.append(stamp_us)
        assert self._clock.offset_s is not None
        return min(stamp_us * 1e-6 - self._clock.offset_s, now_s)
