"""The autopilot's stamps, put on its boot clock; what is late, of the future or out of order is not used."""

import math
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from enum import Enum

from swingd.link.clock import AHEAD_S, LATE_S, RemoteClock, Verdict, unwrap
from swingd.model.events import AutopilotRestart, Event, Stream

# The boot clock is kept modulo the 32 bit of time_boot_ms; SERVO_OUTPUT_RAW.time_usec has 32 bit of microseconds.
_BOOT_PERIOD_US = 2**32 * 1000
_BOOT_PERIOD_S = _BOOT_PERIOD_US * 1e-6
_USEC32_PERIOD_S = 2**32 * 1e-6
_UNIX_MIN_US = 10**15
_UNIX_MAX_US = 10**16
_UNIX_LATCH_S = 1.0
_UNIX_STEP_S = 0.005
_SAME_S = 5e-7


class Drop(Enum):
    """Why something received or asked for was not used."""

    OTHER_SENDER = "other_sender"
    """A message that swingd consumes, from a system or component that it does not serve."""
    NOT_FINITE = "not_finite"
    """A field is NaN or infinite."""
    IMPOSSIBLE = "impossible"
    """A field is outside of what can be."""
    FROZEN = "frozen"
    """The same inertial reading again and again, under new stamps: a sensor that hangs; a real one always has noise."""
    DUPLICATE = "duplicate"
    """The stamp of the stream's last sample again."""
    REORDERED = "reordered"
    """A stamp before the stream's last sample."""
    LATE = "late"
    """Delivered more than `swingd.link.clock.LATE_S` later than others."""
    AHEAD = "ahead"
    """A stamp of the future."""
    NO_CLOCK = "no_clock"
    """The stamp cannot be related to the boot clock yet."""
    SETPOINT_FRAME = "setpoint_frame"
    """A setpoint addressed to swingd in another frame than LOCAL_NED, or as a force."""
    TARGET_FRAME = "target_frame"
    """LANDING_TARGET of the load without a position, or in another frame than BODY_FRD or LOCAL_NED."""
    OUTGOING = "outgoing"
    """An action that cannot be sent: no autopilot known, not finite, or a setpoint that the autopilot would misread."""


@dataclass(slots=True)
class _Clocks:
    """What is known of the clocks of one life of the autopilot."""

    boot: RemoteClock = field(default_factory=RemoteClock)
    unix: RemoteClock = field(default_factory=RemoteClock)
    unix_first_s: float | None = None
    unix_minus_boot_s: float | None = None
    last_s: dict[Stream, float] = field(default_factory=lambda: dict.fromkeys(Stream, -math.inf))


class Stamps:
    """Puts the stamps of every stream on one boot clock.

    Parameters
    ----------
    drops : Counter of Drop
        Counts what is not to be used.
    received : Counter of Stream
        Counts what is.
    on_restart : callable
        Called when the autopilot has restarted, before the event is given.

    Notes
    -----
    The boot clock is tracked by `RemoteClock` over all streams and counted on over the wrap of ``time_boot_ms`` (49.7
    days; 71.6 minutes for SERVO_OUTPUT_RAW), so the boot time only goes back with an `AutopilotRestart`. A
    ``time_usec`` that is a unix time (above 10^15 us, as MAVLink says) is turned into boot time by a difference that is
    latched once: from SYSTEM_TIME, else from a second of arrivals; a step of the unix clock latches anew.
    """

    def __init__(self, drops: Counter[Drop], received: Counter[Stream], on_restart: Callable[[], None]) -> None:
        self._drops = drops
        self._received = received
        self._on_restart = on_restart
        self._clocks = _Clocks()

    def ms(self, stream: Stream, t_mono_s: float, stamp_ms: int, events: list[Event]) -> float | None:
        """Return the boot time [s] of a ``time_boot_ms``, or None (counted) if its sample is not to be used."""
        return self._boot(stream, t_mono_s, stamp_ms * 1e-3, events)

    def usec(self, stream: Stream, t_mono_s: float, stamp_us: int, events: list[Event]) -> float | None:
        """Return the boot time [s] of a ``time_usec``, or None (counted) if its sample is not to be used."""
        if stamp_us < _UNIX_MIN_US:
            return self._boot(stream, t_mono_s, stamp_us % _BOOT_PERIOD_US * 1e-6, events)
        if stamp_us >= _UNIX_MAX_US:
            self._drops[Drop.IMPOSSIBLE] += 1
            return None
        clocks = self._clocks
        unix_s = stamp_us * 1e-6
        verdict = clocks.unix.judge(t_mono_s, unix_s)
        if verdict is Verdict.RESTART or clocks.unix_first_s is None:
            clocks.unix_first_s = t_mono_s
            clocks.unix_minus_boot_s = None
        if verdict in (Verdict.LATE, Verdict.AHEAD):
            self._drops[Drop.LATE if verdict is Verdict.LATE else Drop.AHEAD] += 1
            return None
        if (
            clocks.unix_minus_boot_s is None
            and t_mono_s - clocks.unix_first_s >= _UNIX_LATCH_S
            and clocks.unix.offset_s is not None
            and clocks.boot.offset_s is not None
        ):
            clocks.unix_minus_boot_s = clocks.unix.offset_s - clocks.boot.offset_s
        expected_s = self._expected_s(t_mono_s)
        if clocks.unix_minus_boot_s is None or expected_s is None:
            self._drops[Drop.NO_CLOCK] += 1
            return None
        t_boot_s = unix_s - clocks.unix_minus_boot_s
        if not -LATE_S < t_boot_s - expected_s <= AHEAD_S:
            # One of the two clocks was set.
            clocks.unix_first_s = t_mono_s
            clocks.unix_minus_boot_s = None
        return self._in_order(stream, t_boot_s, expected_s)

    def usec32(self, stream: Stream, t_mono_s: float, stamp_us: int) -> float | None:
        """Return the boot time [s] of 32 bit of microseconds, or None (counted) if its sample is not to be used."""
        expected_s = self._expected_s(t_mono_s)
        if expected_s is None:
            self._drops[Drop.NO_CLOCK] += 1
            return None
        return self._in_order(stream, unwrap(stamp_us * 1e-6, expected_s, _USEC32_PERIOD_S), expected_s)

    def arrival(self, stream: Stream, t_mono_s: float) -> float | None:
        """Return the boot time [s] that the quickest delivery would have now, for a message without a stamp."""
        expected_s = self._expected_s(t_mono_s)
        if expected_s is None:
            self._drops[Drop.NO_CLOCK] += 1
            return None
        return self._next(stream, expected_s)

    def relate_unix(self, t_mono_s: float, time_unix_usec: int, time_boot_ms: int) -> None:
        """Relate the autopilot's unix clock to its boot clock (SYSTEM_TIME), where its stamps are unix times."""
        clocks = self._clocks
        if clocks.unix_first_s is None or not _UNIX_MIN_US < time_unix_usec < _UNIX_MAX_US:
            return
        expected_s = self._expected_s(t_mono_s)
        if expected_s is None:
            return
        boot_s = unwrap(time_boot_ms * 1e-3, expected_s, _BOOT_PERIOD_S)
        if not -LATE_S < boot_s - expected_s <= AHEAD_S:
            return
        difference_s = time_unix_usec * 1e-6 - boot_s
        known_s = clocks.unix_minus_boot_s
        if known_s is None or abs(difference_s - known_s) > _UNIX_STEP_S:
            clocks.unix_minus_boot_s = difference_s

    @property
    def newest_s(self) -> float | None:
        """The newest stamp of this life of the autopilot, of whatever stream [s]; None before the first."""
        newest_s = max(self._clocks.last_s.values())
        return newest_s if math.isfinite(newest_s) else None

    def _expected_s(self, t_mono_s: float) -> float | None:
        offset_s = self._clocks.boot.offset_s
        return None if offset_s is None else t_mono_s + offset_s

    def _in_order(self, stream: Stream, t_boot_s: float, expected_s: float) -> float | None:
        """Judge a stamp that says nothing about the boot clock itself."""
        if not -LATE_S < t_boot_s - expected_s <= AHEAD_S:
            self._drops[Drop.LATE if t_boot_s < expected_s else Drop.AHEAD] += 1
            return None
        return self._next(stream, t_boot_s)

    def _boot(self, stream: Stream, t_mono_s: float, stamp_s: float, events: list[Event]) -> float | None:
        expected_s = self._expected_s(t_mono_s)
        t_boot_s = stamp_s if expected_s is None else unwrap(stamp_s, expected_s, _BOOT_PERIOD_S)
        verdict = self._clocks.boot.judge(t_mono_s, t_boot_s)
        if verdict is Verdict.GOOD:
            return self._next(stream, t_boot_s)
        if verdict is Verdict.RESTART:
            step_s = self._clocks.boot.step_s
            self._clocks = _Clocks()
            self._clocks.boot.judge(t_mono_s, stamp_s)
            self._on_restart()
            events.append(AutopilotRestart(t_mono_s, step_s))
            return self._next(stream, stamp_s)
        self._drops[Drop.LATE if verdict is Verdict.LATE else Drop.AHEAD] += 1
        return None

    def _next(self, stream: Stream, t_boot_s: float) -> float | None:
        step_s = t_boot_s - self._clocks.last_s[stream]
        if step_s < _SAME_S:
            self._drops[Drop.DUPLICATE if step_s > -_SAME_S else Drop.REORDERED] += 1
            return None
        self._clocks.last_s[stream] = t_boot_s
        self._received[stream] += 1
        return t_boot_s
