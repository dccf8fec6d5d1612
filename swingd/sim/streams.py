"""Messages that an autopilot sends by itself, each at its rate."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

_NEVER_US = -(10**9)


@dataclass(slots=True)
class Stream:
    """One message and its rate."""

    build: Callable[[], Any]
    """Makes the message, or None where there is nothing to tell."""
    default_us: int
    """Interval until something else is asked for; 0 is off."""
    interval_us: int
    """Interval now; 0 is off."""
    last_us: int = _NEVER_US
    data_us: int = -1
    """Stamp of what was sent last."""


class Streams:
    """The streams of PX4.

    Parameters
    ----------
    builders : mapping
        What makes each message, by message id, in the order of sending.
    default_rates_hz : mapping
        Rate of each until something else is asked for; 0 is off.
    """

    early_us = 450
    """A message leaves when more than its interval less this has passed: 0.3 of the loop delay of PX4."""

    def __init__(self, builders: Mapping[int, Callable[[], Any]], default_rates_hz: Mapping[int, float]) -> None:
        self._streams: dict[int, Stream] = {}
        for msg_id, build in builders.items():
            rate_hz = default_rates_hz.get(msg_id, 0.0)
            interval_us = round(1e6 / rate_hz) if rate_hz > 0.0 else 0
            self._streams[msg_id] = Stream(build, interval_us, interval_us)

    def get(self, msg_id: int) -> Stream | None:
        """Give the stream of a message, None if there is none."""
        return self._streams.get(msg_id)

    def reset(self) -> None:
        """Go back to the default rates, as after a boot."""
        for stream in self._streams.values():
            stream.interval_us = stream.default_us
            stream.last_us = _NEVER_US
            stream.data_us = -1

    def due(self, now_us: int, data_us: int) -> Iterator[Any]:
        """Give the messages that are due; ``data_us`` is the stamp of the newest sample."""
        latest_us = now_us + self.early_us
        for stream in self._streams.values():
            interval_us = stream.interval_us
            if 0 < interval_us < latest_us - stream.last_us and self._claim(stream, now_us, data_us):
                message = stream.build()
                if message is not None:
                    yield message

    def _claim(self, stream: Stream, now_us: int, data_us: int) -> bool:
        """PX4 keeps the average rate as long as its loop keeps up, else starts anew, and sends no sample twice."""
        if data_us <= stream.data_us:
            return False
        interval_us = stream.interval_us
        since_us = now_us - stream.last_us
        stream.last_us = stream.last_us + interval_us if 1.5 * interval_us > since_us else now_us
        stream.data_us = data_us
        return True


class CopterStreams(Streams):
    """The streams of Copter, which counts in whole milliseconds."""

    early_us = 1

    def _claim(self, stream: Stream, now_us: int, data_us: int) -> bool:
        interval_us = stream.interval_us
        since_us = now_us - stream.last_us
        stream.last_us = stream.last_us + interval_us if since_us < 2 * interval_us else now_us
        return True
