"""The configuration's schema, derived from the dataclasses of `swingd.model.parameters`."""

import dataclasses
import functools
import operator
from collections.abc import Iterator
from dataclasses import dataclass
from enum import Enum
from types import MappingProxyType
from typing import Annotated, Any, Literal, get_args, get_origin, get_type_hints

from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, create_model

from swingd.model.parameters import Parameters

TEXT_MAX = 200
"""Longest text that a key takes, in characters."""


@dataclass(frozen=True, slots=True)
class Key:
    """One configurable value."""

    path: tuple[str, ...]
    type: Any
    """float, int, bool, str, an Enum, or a tuple of floats."""
    default: Any
    text: str
    """Its meaning, one line."""
    unit: str = ""
    """Unit of a number; empty where it has none."""
    low: float | None = None
    high: float | None = None
    """Bounds, inclusive; every number has both."""
    names: tuple[str, ...] = ()
    """What a text may be; empty for any text."""
    mavlink: str = ""
    """Name in the PARAM protocol; empty where it cannot be changed there."""

    @property
    def name(self) -> str:
        """Dotted name, as in ``--set``."""
        return ".".join(self.path)

    @property
    def choices(self) -> tuple[str, ...]:
        """What may be written; empty where it cannot be listed."""
        if isinstance(self.type, type) and issubclass(self.type, Enum):
            return tuple(member.value for member in self.type)
        return self.names

    @property
    def size(self) -> int:
        """Length of a vector, 1 otherwise."""
        return len(get_args(self.type)) if get_origin(self.type) is tuple else 1

    @property
    def range(self) -> str:
        """Bounds without unit, ``0.05 .. 2000``, or the choices; empty for switches and free texts."""
        if self.low is not None and self.high is not None:
            return f"{number_text(self.low)} .. {number_text(self.high)}"
        return ", ".join(self.choices)

    @property
    def expected(self) -> str:
        """What may stand here, in words, with the unit."""
        if self.type is bool:
            return "true or false"
        if self.choices:
            return "one of " + ", ".join(self.choices)
        if self.low is None or self.high is None:
            return f"a text of 1 to {TEXT_MAX} printable characters"
        limits = f"from {number_text(self.low)} to {number_text(self.high)}" + (f" {self.unit}" if self.unit else "")
        if self.size > 1:
            return f"a list of {self.size} numbers, each {limits}"
        return f"a {'whole number' if self.type is int else 'number'} {limits}"


def number_text(value: float) -> str:
    """Write a bound as briefly as it can be read."""
    return str(value) if isinstance(value, int) else f"{value:.15g}"


def _walk(cls: type[Any], prefix: tuple[str, ...]) -> Iterator[Key]:
    types = get_type_hints(cls)
    for field in dataclasses.fields(cls):
        path = (*prefix, field.name)
        if dataclasses.is_dataclass(types[field.name]):
            yield from _walk(types[field.name], path)
            continue
        metadata = dict(field.metadata)
        if metadata.get("unit") == "1":
            metadata["unit"] = ""
        yield Key(path, types[field.name], field.default, **metadata)


KEYS = MappingProxyType({key.name: key for key in _walk(Parameters, ())})
"""Every key by its dotted name, in the order of declaration."""

GROUPS = MappingProxyType(
    {
        field.name: (get_type_hints(Parameters)[field.name].__doc__ or "").strip()
        for field in dataclasses.fields(Parameters)
        if dataclasses.is_dataclass(get_type_hints(Parameters)[field.name])
    }
)
"""What each group of keys is, by its name."""


def value_of(parameters: Parameters, name: str) -> Any:
    """Give the value of a dotted key."""
    return operator.attrgetter(name)(parameters)


def plain(value: Any) -> Any:
    """Give ``value`` as YAML and JSON write it: an enumeration by its value, a vector as a list."""
    if isinstance(value, Enum):
        return value.value
    return list(value) if isinstance(value, tuple) else value


def nested(parameters: Parameters) -> dict[str, Any]:
    """Give all parameters as nested mappings of plain values."""
    tree: dict[str, Any] = {}
    for key in KEYS.values():
        group = tree
        for part in key.path[:-1]:
            group = group.setdefault(part, {})
        group[key.path[-1]] = plain(value_of(parameters, key.name))
    return tree


def _annotation(key: Key) -> Any:
    """Give pydantic's type of a key.

    Strict throughout, so that a text is no number and a switch no 1; vectors alone are lax, because YAML has lists
    only. An enumeration is a literal here, because Enum formats the whole of whatever it refuses.
    """
    text = f"{key.text} [{key.unit}]" if key.unit else key.text
    if key.low is not None:
        if key.type is int:
            return Annotated[int, Field(ge=key.low, le=key.high, description=text)]
        number: Any = Annotated[float, Field(ge=key.low, le=key.high, allow_inf_nan=False)]
        if key.size == 1:
            return Annotated[number, Field(description=text)]
        vector: Any = tuple.__class_getitem__((number,) * key.size)
        return Annotated[vector, Field(description=text, strict=False)]
    if key.type is bool:
        return Annotated[bool, Field(description=text)]
    if key.choices:
        names: Any = Literal.__getitem__(key.choices)
        return Annotated[names, Field(description=text)]
    return Annotated[
        str, Field(description=text, min_length=1, max_length=TEXT_MAX, pattern=r"^[^\x00-\x1f\x7f-\x9f]+$")
    ]


@functools.cache
def model_of(cls: type[Any]) -> type[BaseModel]:
    """Derive the pydantic model of one parameter dataclass.

    Parameters
    ----------
    cls : type
        A dataclass of `swingd.model.parameters`, groups nested.

    Returns
    -------
    type[pydantic.BaseModel]
        Same fields and defaults; refuses unknown keys, values out of bounds, NaN and infinity, and numbers written as
        texts or switches.
    """
    types = get_type_hints(cls)
    fields: dict[str, Any] = {}
    for key in _walk(cls, ()):
        name = key.path[0]
        if len(key.path) == 1:
            fields[name] = (_annotation(key), plain(key.default))
        else:
            fields[name] = (model_of(types[name]), Field(default_factory=model_of(types[name])))
    model: type[BaseModel] = create_model(
        cls.__name__,
        __config__=ConfigDict(extra="forbid", strict=True, frozen=True, validate_default=True),
        __doc__=cls.__doc__,
        **fields,
    )
    return model


_PARAMETERS = TypeAdapter(Parameters)


def build(model: BaseModel) -> Parameters:
    """Turn a validated model into the frozen dataclasses."""
    return _PARAMETERS.validate_python(model.model_dump())


def json_schema() -> dict[str, Any]:
    """Give the JSON schema of a configuration file, for editors."""
    schema = model_of(Parameters).model_json_schema()
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **schema, "title": "swingd configuration"}
