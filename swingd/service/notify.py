"""What systemd is told of the daemon, after sd_notify(3): that it is ready, how it is, that it makes progress.

Light, and only imported under systemd: it is part of the way to the first forwarded frame.
"""

import contextlib
import os
import socket
import time
from collections.abc import Mapping

from swingd.model.errors import ConfigurationError

FEEDINGS = 4
"""Times that the watchdog is fed in its period: one that is left out does no harm."""


class Supervisor:
    """The service manager behind a notify socket.

    Parameters
    ----------
    address : str
        Path of the socket, or ``@`` and its name in the abstract namespace.
    watchdog_s : float, optional
        Period after which the service manager ends a process that it has not heard of [s]; None: it has no watchdog.

    Notes
    -----
    Nothing here waits or raises: a service manager that does not read must not hold up what is forwarded. What it has
    not taken is said again by `feed`.
    """

    def __init__(self, address: str, watchdog_s: float | None = None) -> None:
        self._address = "\0" + address[1:] if address.startswith("@") else address
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        self._period_s = None if watchdog_s is None else watchdog_s / FEEDINGS
        self._due_s = 0.0
        self._samples = 0
        self._intervals: int | None = None
        self._status = ""
        self._owed: dict[str, str] = {}

    @classmethod
    def from_environment(cls, environment: Mapping[str, str]) -> "Supervisor | None":
        """Return the one that ``NOTIFY_SOCKET``, ``WATCHDOG_USEC`` and ``WATCHDOG_PID`` name; None if there is none.

        Raises
        ------
        ConfigurationError
            If one of them is not what systemd sets.
        """
        address = environment.get("NOTIFY_SOCKET", "")
        if not address:
            return None
        if len(address) < 2 or address[0] not in "/@":
            raise ConfigurationError(f"NOTIFY_SOCKET: {address!r}; expected an absolute path, or @ and a name")
        period_us = _whole(environment, "WATCHDOG_USEC")
        meant_for = _whole(environment, "WATCHDOG_PID")
        if period_us is None or meant_for not in (None, os.getpid()):
            return cls(address)
        return cls(address, period_us * 1e-6)

    def ready(self) -> None:
        """Tell that the links are open, from now on what is received is forwarded; or that a reload has ended."""
        for name in ("RELOADING", "MONOTONIC_USEC"):
            self._owed.pop(name, None)
        self._tell(READY="1")

    def reloading(self) -> None:
        """Tell that the configuration is being read again, until `ready`."""
        self._owed.pop("READY", None)
        self._tell(RELOADING="1", MONOTONIC_USEC=str(time.monotonic_ns() // 1000))

    def stopping(self) -> None:
        """Tell that the end has begun."""
        self._tell(STOPPING="1", STATUS="stopping")

    def status(self, text: str) -> None:
        """Tell how things are, on one line, where that is not what was told last."""
        line = " ".join(text.split())
        if line != self._status:
            self._status = line
            self._tell(STATUS=line)

    def feed(self, t_mono_s: float, samples: int, intervals: int | None) -> None:
        """Feed the watchdog if there is progress; to be called at some 20 Hz.

        Parameters
        ----------
        t_mono_s : float
            The host's monotonic clock [s].
        samples : int
            Samples of the autopilot's IMU so far.
        intervals : int or None
            Filter intervals that the pipeline has taken so far. While samples come it must take some; without samples,
            or where there is no pipeline that could (None), it is progress to be called.
        """
        if self._owed:
            self._tell()
        if self._period_s is None or t_mono_s < self._due_s:
            return
        self._due_s = t_mono_s + self._period_s
        waits = samples != self._samples
        advances = intervals is None or intervals != self._intervals
        self._samples, self._intervals = samples, intervals
        if advances or not waits:
            self._send("WATCHDOG=1")

    def close(self) -> None:
        """Give the socket back."""
        self._socket.close()

    def _tell(self, **variables: str) -> None:
        self._owed |= variables
        if self._send("\n".join(f"{name}={value}" for name, value in self._owed.items())):
            self._owed.clear()

    def _send(self, text: str) -> bool:
        with contextlib.suppress(OSError):
            self._socket.sendto(text.encode(errors="replace"), self._address)
            return True
        return False


def _whole(environment: Mapping[str, str], name: str) -> int | None:
    """Return a variable that is a number above 0; None where it is not set."""
    text = environment.get(name, "")
    if not text:
        return None
    if not (text.isascii() and text.isdigit() and int(text) > 0):
        raise ConfigurationError(f"{name}: {text!r}; expected a whole number above 0")
    return int(text)
