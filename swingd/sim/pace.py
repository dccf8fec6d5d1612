"""When the next step of a simulation is due on the wall clock."""

import asyncio

from swingd.sim.plant import DT_S

CATCH_UP_MAX_S = 0.2
"""Real time that is made up for after a stall; the rest is skipped, so that no burst of stale data goes out."""

_TURN_STEPS = 8
_WINDOW_S = 1.0


class Pace:
    """Lets a simulation of `DT_S` a step keep to the wall clock.

    Parameters
    ----------
    speed : float
        Simulated over real time, above 0.

    Notes
    -----
    It does not drift: each step is due at its own time from the start. Who falls behind by more than `CATCH_UP_MAX_S`
    (a suspended machine, a busy core, an autopilot that halts in a debugger) goes on from there.
    """

    def __init__(self, speed: float) -> None:
        self._interval_s = DT_S / speed
        self._steps = 0
        self._due_s = 0.0
        self._mark = (0.0, 0)
        self._next_mark = (0.0, 0)

    async def due(self) -> None:
        """Return when the next step is due; the first one is at once.

        Whoever shares the event loop gets a turn at least every eighth time, even while this one is behind.
        """
        loop = asyncio.get_running_loop()
        now_s = loop.time()
        if self._steps == 0:
            self._due_s = now_s
            self._mark = self._next_mark = (now_s, 0)
        elif self._steps % _TURN_STEPS == 0:
            await asyncio.sleep(0)
            now_s = loop.time()
        while now_s < self._due_s:
            await asyncio.sleep(self._due_s - now_s)
            now_s = loop.time()
        if now_s - self._next_mark[0] >= _WINDOW_S:
            self._mark, self._next_mark = self._next_mark, (now_s, self._steps)
        self._due_s = max(self._due_s, now_s - CATCH_UP_MAX_S) + self._interval_s
        self._steps += 1

    @property
    def factor(self) -> float:
        """Simulated over real time that was achieved in the last one to two seconds; 0 before the first step."""
        if self._steps == 0:
            return 0.0
        since_s, steps = self._mark
        passed_s = max(asyncio.get_running_loop().time() - since_s, self._interval_s)
        return (self._steps - steps) * DT_S / passed_s
