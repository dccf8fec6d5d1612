"""A configuration that has been read and not yet judged."""

import reprlib
from dataclasses import dataclass, field
from typing import Any

from swingd.model.errors import ConfigurationError

Place = int | str
"""Where a key was given: a line of the file, counted from 1, or the name of an option."""

_repr = reprlib.Repr()
_repr.maxstring = _repr.maxother = _repr.maxlong = 60
_repr.maxlevel = 2
_WORDS = {"None": "nothing", "True": "true", "False": "false"}


@dataclass(slots=True)
class Draft:
    """Values, where each was given, and what is wrong with them."""

    values: dict[str, Any] = field(default_factory=dict)
    """Nested as in the file; keys are texts."""
    places: dict[str, Place] = field(default_factory=dict)
    """By dotted key."""
    problems: list[tuple[Place, str]] = field(default_factory=list)
    refused: set[str] = field(default_factory=set)
    """Dotted keys and groups that have a problem."""

    def place(self, name: str) -> Place:
        """Tell where the dotted key ``name`` was given, or else the nearest group around it; empty if neither was."""
        while name and name not in self.places:
            name = name.rpartition(".")[0]
        return self.places.get(name, "")

    def is_refused(self, name: str) -> bool:
        """Whether the dotted key ``name`` has a problem, or a group around it."""
        while name and name not in self.refused:
            name = name.rpartition(".")[0]
        return bool(name)

    def refuse(self, name: str, text: str, place: Place | None = None) -> None:
        """Note what is wrong with the dotted key ``name``, given at ``place`` or where it is known to stand."""
        where = self.place(name) if place is None else place
        suffix = f" (line {where})" if isinstance(where, int) else f" ({where})" if where else ""
        self.refused.add(name)
        self.problems.append((where, f"{printable(name)}{suffix}: {text}"))

    def raise_problems(self, title: str) -> None:
        """Raise `ConfigurationError` with every problem, in the order of the file; return if there are none."""
        if not self.problems:
            return
        # Lines first, then options and the rest in the order found.
        ordered = sorted(self.problems, key=lambda problem: (isinstance(problem[0], str), problem[0] or "~"))
        count = len(ordered)
        head = f"{title}: {count} problem{'s' if count > 1 else ''}"
        raise ConfigurationError("\n  ".join([head, *(text for _, text in ordered)]))


def shown(value: object) -> str:
    """Show a value briefly and on one line, whatever it is."""
    text = _repr.repr(value)
    return printable(_WORDS.get(text, text))


def printable(text: str) -> str:
    """Keep a text from outside readable, on one line and short."""
    text = "".join(char if char.isprintable() else ascii(char)[1:-1] for char in text)
    return text if len(text) <= 120 else f"{text[:117]}..."
