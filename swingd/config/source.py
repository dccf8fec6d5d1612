"""A configuration as it is given: the bytes of a file, and overrides; read once, whatever then becomes of it."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from swingd.config.draft import shown
from swingd.model.errors import ConfigurationError

SIZE_MAX = 256 * 1024
"""Largest file that is read [bytes]."""


FILE_SIZE_MAX = 4 * 1024 * 1024
"""Largest file that a key may name [bytes]."""


@dataclass(frozen=True, slots=True)
class Source:
    """What a configuration is made of."""

    name: str
    """The file, for messages."""
    content: bytes
    """YAML in UTF-8; empty without a file."""
    overrides: tuple[str, ...]
    """``KEY=VALUE`` each."""
    folder: Path = Path()
    """Of the file."""

    def folder_of(self, key: str) -> Path:
        """Give what a file that a key names is relative to: the file's folder, for an override the working folder."""
        overridden = any(override.partition("=")[0].strip() == key for override in self.overrides)
        return Path() if overridden else self.folder


def read_source(path: Path | str | None, overrides: Sequence[str]) -> Source:
    """Read a file, if there is one.

    Raises
    ------
    ConfigurationError
        If the file cannot be read or is larger than `SIZE_MAX`.
    """
    if path is None:
        return Source("configuration", b"", tuple(overrides))
    content = _read(Path(path), SIZE_MAX, "configuration file in YAML")
    return Source(str(path), content, tuple(overrides), Path(path).parent)


def read_named(folder: Path, name: str) -> str:
    """Read a file that a key names.

    Raises
    ------
    ConfigurationError
        If it cannot be read, is larger than `FILE_SIZE_MAX`, or is not UTF-8; the text names the file.
    """
    path = folder / name
    content = _read(path, FILE_SIZE_MAX, "file")
    try:
        return content.decode("utf-8")
    except UnicodeDecodeError:
        raise ConfigurationError(f"{path}: not UTF-8") from None


def _read(path: Path, size_max: int, what: str) -> bytes:
    try:
        with open(path, "rb") as file:
            content = file.read(size_max + 1)
    except OSError as error:
        raise ConfigurationError(f"{path}: {error.strerror or error}; expected a {what}") from None
    except ValueError as error:
        raise ConfigurationError(f"{shown(str(path))}: {error}; expected the path of a {what}") from None
    if len(content) > size_max:
        raise ConfigurationError(f"{path}: larger than {size_max // 1024} KiB; expected a {what}")
    return content
