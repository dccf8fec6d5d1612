"""The parameters that a ground station may set while swingd runs, derived from their declarations."""

import dataclasses
from collections.abc import Iterator
from dataclasses import dataclass
from operator import attrgetter
from types import MappingProxyType
from typing import Any, get_type_hints

from swingd.model.parameters import Parameters

NAME_MAX = 16
"""Characters that a name of the PARAM protocol may have."""


@dataclass(frozen=True, slots=True)
class GroundParameter:
    """One number or switch under its name of the PARAM protocol."""

    index: int
    """Its place in the list, from 0; the same as long as the program is."""
    name: str
    key: str
    """Dotted key of the configuration."""
    low: float
    high: float
    """Bounds, inclusive; 0 and 1 of a switch."""
    unit: str
    """Empty where it has none."""
    text: str
    """Its meaning, one line."""
    is_switch: bool
    """Whether it is off (0) or on (1) and nothing between."""

    def get(self, parameters: Parameters) -> float:
        """Give its value; 0 or 1 for a switch."""
        return float(attrgetter(self.key)(parameters))

    def put(self, parameters: Parameters, value: float) -> Parameters:
        """Give the parameters with this one changed.

        Raises
        ------
        ValueError
            If the value is out of bounds, not finite, or neither 0 nor 1 for a switch.
        """
        if not self.low <= value <= self.high or (self.is_switch and value not in (0.0, 1.0)):
            raise ValueError(f"{self.name}: {value!r} given; expected {self.expected}")
        group, last = self.key.split(".")
        changed = dataclasses.replace(getattr(parameters, group), **{last: bool(value) if self.is_switch else value})
        return dataclasses.replace(parameters, **{group: changed})

    @property
    def expected(self) -> str:
        """What may be set, in words, with the unit."""
        if self.is_switch:
            return "0 or 1"
        return f"{self.low:g} to {self.high:g}" + (f" {self.unit}" if self.unit else "")


def _declared() -> Iterator[GroundParameter]:
    index = 0
    for group, cls in get_type_hints(Parameters).items():
        if not dataclasses.is_dataclass(cls):
            continue
        types: dict[str, Any] = get_type_hints(cls)
        for field in dataclasses.fields(cls):
            name = field.metadata.get("mavlink")
            if not name:
                continue
            key = f"{group}.{field.name}"
            is_switch = types[field.name] is bool
            if not is_switch and types[field.name] is not float:
                raise TypeError(f"{key}: a {types[field.name]} cannot be set over MAVLink; expected a float or a bool")
            if len(name) > NAME_MAX:
                raise ValueError(f"{key}: {name!r} given; expected a MAVLink name of at most {NAME_MAX} characters")
            unit = field.metadata.get("unit", "")
            yield GroundParameter(
                index=index,
                name=name,
                key=key,
                low=float(field.metadata.get("low", 0.0)),
                high=float(field.metadata.get("high", 1.0)),
                unit="" if unit == "1" else unit,
                text=field.metadata["text"],
                is_switch=is_switch,
            )
            index += 1


GROUND_PARAMETERS = tuple(_declared())
"""Every parameter that may be set over MAVLink, in the order of declaration, which is that of the indices."""

BY_NAME = MappingProxyType({parameter.name: parameter for parameter in GROUND_PARAMETERS})
"""The same by the name of the PARAM protocol."""

BY_KEY = MappingProxyType({parameter.key: parameter for parameter in GROUND_PARAMETERS})
"""The same by the dotted key of the configuration."""
