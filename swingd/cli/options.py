"""Options that several commands share."""

import asyncio
import os
import signal
from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import typer

Config = Annotated[
    Path | None,
    typer.Option("-c", "--config", metavar="FILE", help="Configuration in YAML; without it every key has its default."),
]
Overrides = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="KEY=VALUE", help="Set one key, for example payload.mass_kg=0.4; repeatable."),
]
Json = Annotated[bool, typer.Option("--json", help="Print one JSON object instead of text.")]


def check_output(path: Path | None, option: str, inputs: tuple[Path | None, ...] = (), keep: bool = False) -> None:
    """Refuse a file that could not be written in the end, before any work is done.

    Parameters
    ----------
    path : Path or None
        The file; None is no file.
    option : str
        How the user gave it.
    inputs : paths
        Files that are read: writing over one of them would destroy it.
    keep : bool
        Refuse to replace an existing file.

    Raises
    ------
    ConfigurationError
        If it cannot be written, or must not be.
    """
    from swingd.model.errors import ConfigurationError

    if path is None:
        return
    folder = path.resolve().parent
    if not folder.is_dir():
        raise ConfigurationError(f"{option}: {path}: there is no folder {folder}")
    if path.is_dir():
        raise ConfigurationError(f"{option}: {path} is a folder; expected a file")
    if any(given is not None and given.exists() and path.exists() and path.samefile(given) for given in inputs):
        raise ConfigurationError(f"{option}: {path} is read by this command; expected another file")
    if keep and path.is_file():
        raise ConfigurationError(f"{option}: {path} exists; expected a new file, a flight is not overwritten")
    if not os.access(path if path.exists() else folder, os.W_OK):
        raise ConfigurationError(f"{option}: {path} cannot be written: permission denied")


def announce_compilation() -> None:
    """Say so on standard error where the filter will be compiled first: it takes some twenty seconds."""
    from swingd.core._jit import is_compiled

    if not is_compiled():
        typer.echo("compiling the filter, once for this version: some twenty seconds", err=True)


def end_on_signals() -> None:
    """Let SIGTERM and SIGHUP unwind like Ctrl-C, so that processes are ended and temporary files removed."""

    def end(number: int, _frame: object) -> None:
        raise SystemExit(128 + number)

    for number in (signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, end)


def event_loop_factory() -> Callable[[], asyncio.AbstractEventLoop] | None:
    """Return uvloop's factory where it is installed, else None for asyncio's own."""
    try:
        import uvloop
    except ImportError:
        return None
    factory: Callable[[], asyncio.AbstractEventLoop] = uvloop.new_event_loop
    return factory
