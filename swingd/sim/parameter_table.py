"""Parameters of a simulated autopilot by name, as its PARAM protocol shows them."""

from collections.abc import Iterator, Mapping
from math import isfinite

INT32 = range(-(2**31), 2**31)


class ParameterTable:
    """Values by name; the type of each is the type of its default.

    Parameters
    ----------
    defaults : mapping
        Every parameter with its default: an ``int`` is whole on the link, a ``float`` a REAL32.
    changes : mapping
        Values other than the defaults.

    Raises
    ------
    KeyError
        If a name is unknown or a value not finite.
    """

    def __init__(self, defaults: Mapping[str, float | int], changes: Mapping[str, float] | None = None) -> None:
        self._defaults = defaults
        self._values: dict[str, float | int] = dict(defaults)
        self.version = 0
        """Counts the changes, so that a reader knows when to look again."""
        for name, value in (changes or {}).items():
            if not self.set(name, value):
                raise KeyError(f"{name} = {value!r}: expected one of the parameters known here and a finite value")

    def __getitem__(self, name: str) -> float:
        return self._values[name]

    def __contains__(self, name: object) -> bool:
        return name in self._values

    def __iter__(self) -> Iterator[str]:
        return iter(self._values)

    def __len__(self) -> int:
        return len(self._values)

    def is_int(self, name: str) -> bool:
        """Whether the parameter is a whole number."""
        return isinstance(self._defaults[name], int)

    def set(self, name: str, value: float) -> bool:
        """Set a value; False if the name is unknown, or the value not finite or beyond the type."""
        if name not in self._values or not isfinite(value):
            return False
        if self.is_int(name) and int(value) not in INT32:
            return False
        self._values[name] = int(value) if self.is_int(name) else float(value)
        self.version += 1
        return True
