"""The socket on which a running daemon says how it is, and how to ask it.

Whoever connects gets one JSON object and the end of the connection; nothing is read. The daemon writes it with one
system call into the connection's buffer, which holds it whether or not anybody reads, and closes: no client can hold
it up or make anything grow.
"""

import asyncio
import contextlib
import json
import os
import re
import socket
import stat
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from swingd.model.errors import SwingdError
from swingd.service.state import configuration_name

ANSWER_KEPT_S = 0.1
"""For this long one answer serves whoever asks: asking often costs no more than that."""
ANSWER_MAX_BYTES = 1 << 20
ASK_TIMEOUT_S = 3.0
SYSTEM_FOLDER = Path("/run/swingd")
"""``RuntimeDirectory`` of the service; those of ``swingd@NAME`` are called ``swingd@NAME`` beside it, because systemd
removes the whole folder of a service that ends."""

_ACCEPT_PAUSE_S = 1.0
_NAME = re.compile(r"(?P<name>.+?)(?:-(?P<digest>[0-9a-f]{12}))?\.(?P<pid>[0-9]+)\.sock")


class StatusError(SwingdError):
    """No daemon could be asked; the text says which and why."""


def runtime_folder() -> Path:
    """Folder of the sockets of daemons that this process starts.

    systemd's ``$RUNTIME_DIRECTORY`` (the first of it), else ``$XDG_RUNTIME_DIR/swingd``, else a folder of the user's
    own among the temporary files.
    """
    given = os.environ.get("RUNTIME_DIRECTORY", "").split(":")[0]
    if given:
        return Path(given)
    session = os.environ.get("XDG_RUNTIME_DIR", "")
    if os.path.isabs(session):
        return Path(session) / "swingd"
    return Path(os.environ.get("TMPDIR") or "/tmp") / f"swingd-{os.geteuid()}"


# ------------------------------------------------------------------------------------------------------- asked


@dataclass(frozen=True, slots=True)
class StatusSocket:
    """The socket of a daemon, by its file's name."""

    path: Path
    name: str
    """Of the configuration's file, without its ending; ``default`` where there is none."""
    digest: str
    """Of the configuration's whole path; empty where there is none."""
    pid: int
    """Process that made it."""

    @classmethod
    def at(cls, path: Path) -> "StatusSocket | None":
        """Read a path; None if it is not that of such a socket."""
        match = _NAME.fullmatch(path.name)
        if match is None:
            return None
        return cls(path, match["name"], match["digest"] or "", int(match["pid"]))

    def belongs_to(self, configuration: Path | None) -> bool:
        """Whether its daemon was started with this configuration file."""
        return configuration_name(configuration) == (f"{self.name}-{self.digest}" if self.digest else self.name)


class StatusServer:
    """Answers on a Unix socket in the running event loop.

    Parameters
    ----------
    configuration : Path or None
        The configuration file, after which the socket is named.
    folder : Path, optional
        Where it lies instead of `runtime_folder`.
    """

    def __init__(self, configuration: Path | None, folder: Path | None = None) -> None:
        self.path = (folder or runtime_folder()) / f"{configuration_name(configuration)}.{os.getpid()}.sock"
        self.configuration = configuration
        self._answer: Callable[[], dict[str, Any]] = dict
        self._answered_s = -float("inf")
        self._text = b""
        self._socket: socket.socket | None = None
        self._loop: asyncio.AbstractEventLoop | None = None
        self._resumption: asyncio.TimerHandle | None = None

    def open(self, answer: Callable[[], dict[str, Any]]) -> tuple[int, ...]:
        """Listen; return the processes of other daemons that fly by the same configuration.

        Sockets that a killed daemon left behind are removed.

        Parameters
        ----------
        answer : callable
            Gives the object that is told; called at most once in `ANSWER_KEPT_S`.

        Raises
        ------
        OSError
            If there can be no socket, its folder being somebody else's for example.
        """
        self._answer = answer
        folder = self.path.parent
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        status = folder.lstat()
        if not stat.S_ISDIR(status.st_mode) or status.st_uid not in (0, os.geteuid()):
            raise PermissionError(f"{folder} belongs to another user")
        others = []
        for found in _sockets_in(folder):
            if found.path != self.path and found.belongs_to(self.configuration):
                if _is_answered(found.path):
                    others.append(found.pid)
                else:
                    found.path.unlink(missing_ok=True)
        listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM | socket.SOCK_NONBLOCK)
        # Under its name only once it listens and is closed to others: nobody finds it earlier, and takes it for dead.
        unfinished = self.path.with_name(f".{os.getpid()}")
        try:
            unfinished.unlink(missing_ok=True)
            listener.bind(str(unfinished))
            unfinished.chmod(0o660)
            listener.listen()
            unfinished.replace(self.path)
        except BaseException:
            listener.close()
            with contextlib.suppress(OSError):
                unfinished.unlink(missing_ok=True)
            raise
        self._socket = listener
        self._loop = asyncio.get_running_loop()
        self._listen()
        return tuple(others)

    def close(self) -> None:
        """Remove the socket; may be called twice, and before `open`."""
        if self._socket is None or self._loop is None:
            return
        if self._resumption is not None:
            self._resumption.cancel()
        self._loop.remove_reader(self._socket)
        self._socket.close()
        self._socket = None
        with contextlib.suppress(OSError):
            self.path.unlink(missing_ok=True)

    def _listen(self) -> None:
        assert self._socket is not None
        assert self._loop is not None
        self._loop.add_reader(self._socket, self._serve)

    def _serve(self) -> None:
        assert self._socket is not None
        assert self._loop is not None
        try:
            client, _ = self._socket.accept()
        except (BlockingIOError, InterruptedError, ConnectionAbortedError):
            return
        except OSError:
            # Without a free descriptor the connection goes on waiting, and the loop would call again at once.
            self._loop.remove_reader(self._socket)
            self._resumption = self._loop.call_later(_ACCEPT_PAUSE_S, self._listen)
            return
        with client:
            now_s = time.monotonic()
            if now_s - self._answered_s >= ANSWER_KEPT_S:
                self._answered_s = now_s
                self._text = json.dumps(self._answer()).encode() + b"\n"
            client.setblocking(False)
            with contextlib.suppress(OSError):
                client.send(self._text)


def _is_answered(path: Path) -> bool:
    """Whether somebody listens on a socket; a doubt is a yes."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM | socket.SOCK_NONBLOCK) as probe:
        try:
            probe.connect(str(path))
        except (ConnectionRefusedError, FileNotFoundError):
            return False
        except OSError:
            return True
        return True


# -------------------------------------------------------------------------------------------------------- asks


def sockets(*others: Path) -> list[StatusSocket]:
    """Every socket of a daemon that this user may see, the system's own services and ``others``' folders included."""
    folders = [*others, runtime_folder(), SYSTEM_FOLDER]
    with contextlib.suppress(OSError):
        folders += sorted(SYSTEM_FOLDER.parent.glob(f"{SYSTEM_FOLDER.name}@*"))
    return [found for folder in dict.fromkeys(folders) for found in _sockets_in(folder)]


def _sockets_in(folder: Path) -> list[StatusSocket]:
    try:
        paths = sorted(folder.iterdir())
    except OSError:
        return []
    return [found for path in paths if (found := StatusSocket.at(path)) is not None]


def ask(path: Path, timeout_s: float = ASK_TIMEOUT_S) -> dict[str, Any]:
    """Return what the daemon behind a socket says of itself.

    Raises
    ------
    StatusError
        If there is none, or its answer is none.
    """
    end_s = time.monotonic() + timeout_s
    data = b""
    try:
        with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as client:
            client.settimeout(timeout_s)
            _connect(client, path, end_s)
            while len(data) < ANSWER_MAX_BYTES:
                client.settimeout(max(end_s - time.monotonic(), 1e-3))
                part = client.recv(65536)
                if not part:
                    break
                data += part
    except (ConnectionRefusedError, FileNotFoundError, ConnectionResetError):
        raise StatusError(f"{path}: no swingd answers; it was killed, or ends at this moment") from None
    except PermissionError:
        raise StatusError(f"{path}: permission denied; expected its user, or a member of its group") from None
    except TimeoutError:
        raise StatusError(f"{path}: no answer within {timeout_s:g} s; is the process stopped?") from None
    except OSError as error:
        raise StatusError(f"{path}: {error.strerror or error}") from None
    try:
        answer = json.loads(data)
    except ValueError:
        raise StatusError(f"{path}: {data[:40]!r} answered; expected a JSON object") from None
    if not isinstance(answer, dict):
        raise StatusError(f"{path}: {answer!r} answered; expected a JSON object")
    return answer


def _connect(client: socket.socket, path: Path, end_s: float) -> None:
    """Connect; where so many ask that its queue is full, wait for a place."""
    while True:
        try:
            client.connect(str(path))
        except BlockingIOError:
            if time.monotonic() > end_s:
                raise TimeoutError from None
            time.sleep(0.01)
        else:
            return
