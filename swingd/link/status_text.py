"""How many texts for the pilot leave: a screen that is flooded is not read."""

import math
from collections import deque
from dataclasses import dataclass

from swingd.model.actions import Severity, StatusText

TEXTS_MAX = 10
WINDOW_S = 10.0
KEPT_FOR_GRAVE = 4
"""Of `TEXTS_MAX`: places that only `Severity.WARNING` and worse may take."""
WAITING_MAX = 16
WAIT_MAX_S = 30.0
"""A text that could not leave for this long is no longer true."""
REFUSALS_EVERY_S = 1.0
SAME_REFUSAL_EVERY_S = 10.0
"""A ground station tries again what was refused, three to six times."""


@dataclass(slots=True)
class _Line:
    """One text, and how often it came since it was last sent."""

    text: StatusText
    since_s: float
    count: int = 0
    sent_s: float = -math.inf


class StatusTextLimiter:
    """Lets at most `TEXTS_MAX` texts pass in any `WINDOW_S`.

    Notes
    -----
    A text that was sent within the window is not sent again but counted, and told once more with its count when the
    window is over. What finds no place waits, the worst first; places are kept free for warnings and worse. Beyond
    `WAITING_MAX` different texts the least severe are dropped, the oldest first.
    """

    def __init__(self) -> None:
        self.dropped = 0
        """Texts that never left."""
        self._lines: dict[StatusText, _Line] = {}
        self._sent_s: deque[float] = deque()

    def offer(self, t_mono_s: float, text: StatusText) -> tuple[StatusText, ...]:
        """Take one text; give what may leave now.

        Parameters
        ----------
        t_mono_s : float
            The host's monotonic clock [s].
        """
        line = self._lines.get(text)
        if line is None:
            line = self._lines[text] = _Line(text, t_mono_s)
        if not line.count:
            line.since_s = t_mono_s
        line.count += 1
        return self.tick(t_mono_s)

    def tick(self, t_mono_s: float) -> tuple[StatusText, ...]:
        """Let time pass; give what may leave now."""
        while self._sent_s and t_mono_s - self._sent_s[0] >= WINDOW_S:
            self._sent_s.popleft()
        for line in list(self._lines.values()):
            if not line.count and t_mono_s - line.sent_s >= WINDOW_S:
                del self._lines[line.text]
            elif line.count and t_mono_s - max(line.since_s, line.sent_s + WINDOW_S) >= WAIT_MAX_S:
                self._drop(line)
        leaving: list[StatusText] = []
        # MAV_SEVERITY counts downwards: the worst is the smallest. The sort keeps the order of arrival.
        waiting = [line for line in self._lines.values() if line.count and t_mono_s - line.sent_s >= WINDOW_S]
        for line in sorted(waiting, key=lambda line: line.text.severity):
            places = TEXTS_MAX if line.text.severity <= Severity.WARNING else TEXTS_MAX - KEPT_FOR_GRAVE
            if len(self._sent_s) >= places:
                break
            times = f" ({line.count} times)" if line.count > 1 else ""
            leaving.append(StatusText(line.text.severity, line.text.text + times))
            line.count = 0
            line.sent_s = t_mono_s
            self._sent_s.append(t_mono_s)
        waiting = [line for line in self._lines.values() if line.count]
        if len(waiting) > WAITING_MAX:
            least = max(line.text.severity for line in waiting)
            self._drop(next(line for line in waiting if line.text.severity == least))
        return tuple(leaving)

    def _drop(self, line: _Line) -> None:
        self.dropped += line.count
        if math.isfinite(line.sent_s):
            line.count = 0
        else:
            del self._lines[line.text]


class RefusalLimiter:
    """Lets a reason pass once a second, and the same one once in ten: those whom it answers can make up any number."""

    def __init__(self) -> None:
        self._told_s = -math.inf
        self._texts: dict[str, float] = {}

    def offer(self, t_mono_s: float, text: str) -> str | None:
        """Give the text back if it may be told now [s, the host's monotonic clock]."""
        if t_mono_s - self._told_s < REFUSALS_EVERY_S:
            return None
        for told, told_s in list(self._texts.items()):
            if t_mono_s - told_s >= SAME_REFUSAL_EVERY_S:
                del self._texts[told]
        if text in self._texts:
            return None
        self._told_s = self._texts[text] = t_mono_s
        return text
