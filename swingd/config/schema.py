"""The configuration's schema: a tree of groups and keys, derived from the dataclasses of `swingd.model.parameters`."""

import dataclasses
import functools
import operator
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from types import MappingProxyType
from typing import Annotated, Any, Literal, get_args, get_origin, get_type_hints

from pydantic import BaseModel, ConfigDict, Field, create_model

from swingd.config.plain import plain
from swingd.model.parameters import CONTENT_OF, Parameters

TEXT_MAX = 200
"""Longest text that a key takes, in characters."""
LIST_MAX = 16
"""Most items of a list whose length is free: endpoints, system ids."""


@dataclass(frozen=True, slots=True)
class Key:
    """One configurable value."""

    path: tuple[str, ...]
    """From the root; ``N`` stands for the place in a list of groups."""
    type: Any
    """float, int, bool, str, an Enum, or a tuple of numbers or groups; a length that is free ends in an Ellipsis."""
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
    def component(self) -> Any:
        """Type of a list's items, or the type itself."""
        return get_args(self.type)[0] if get_origin(self.type) is tuple else self.type

    @property
    def item(self) -> "Group | None":
        """The group that every item of a list is; None for all other keys."""
        kind = self.component
        return _group(kind, (*self.path, "N")) if hasattr(kind, "__dataclass_fields__") else None

    @property
    def choices(self) -> tuple[str, ...]:
        """What may be written; empty where it cannot be listed."""
        if isinstance(self.type, type) and issubclass(self.type, Enum):
            return tuple(member.value for member in self.type)
        return self.names

    @property
    def sizes(self) -> tuple[int, int] | None:
        """Least and largest length of a list; None for what is no list."""
        if get_origin(self.type) is not tuple:
            return None
        components = get_args(self.type)
        return (0, LIST_MAX) if components[-1] is ... else (len(components), len(components))

    @property
    def range(self) -> str:
        """Bounds without unit, ``0.05 .. 2000``, or the choices; empty for switches and free texts."""
        if self.low is not None and self.high is not None:
            return f"{number_text(self.low)} .. {number_text(self.high)}"
        return ", ".join(self.choices)

    @property
    def expected(self) -> str:
        """What may stand here, in words, with the unit."""
        if self.item is not None:
            return f"a list of at most {LIST_MAX} groups of {', '.join(self.item.members)}"
        if self.type is bool:
            return "true or false"
        if self.choices:
            return "one of " + ", ".join(self.choices)
        if self.low is None or self.high is None:
            return f"a text of 1 to {TEXT_MAX} printable characters"
        limits = f"from {number_text(self.low)} to {number_text(self.high)}" + (f" {self.unit}" if self.unit else "")
        number = "whole number" if self.component is int else "number"
        if self.sizes is None:
            return f"a {number} {limits}"
        low, high = self.sizes
        return f"a list of {high if low == high else f'at most {high}'} {number}s, each {limits}"


@dataclass(frozen=True, slots=True, eq=False)
class Group:
    """Keys under one name."""

    path: tuple[str, ...]
    type: Any
    """Its dataclass."""
    members: Mapping[str, "Key | Group"]
    """In the order of declaration."""

    @property
    def name(self) -> str:
        """Dotted name."""
        return ".".join(self.path)

    @property
    def text(self) -> str:
        """Its meaning, one line."""
        return (self.type.__doc__ or "").strip()

    def every_key(self) -> Iterator[Key]:
        """Give every key below, a list of groups as one."""
        for member in self.members.values():
            if isinstance(member, Group):
                yield from member.every_key()
            else:
                yield member


def number_text(value: float) -> str:
    """Write a bound as briefly as it can be read."""
    return str(value) if isinstance(value, int) else f"{value:.15g}"


@functools.cache
def _group(cls: type[Any], path: tuple[str, ...]) -> Group:
    types = get_type_hints(cls)
    members: dict[str, Key | Group] = {}
    for field in dataclasses.fields(cls):
        if CONTENT_OF in field.metadata:
            continue
        kind = types[field.name]
        here = (*path, field.name)
        if dataclasses.is_dataclass(kind):
            members[field.name] = _group(types[field.name], here)
            continue
        metadata = dict(field.metadata)
        if metadata.get("unit") == "1":
            metadata["unit"] = ""
        members[field.name] = Key(here, kind, field.default, **metadata)
    return Group(path, cls, MappingProxyType(members))


ROOT = _group(Parameters, ())
"""The whole configuration."""

KEYS = MappingProxyType({key.name: key for key in ROOT.every_key()})
"""Every key by its dotted name, in the order of declaration; of a list of groups the list alone."""

ITEM_KEYS = tuple(inner for key in KEYS.values() if key.item is not None for inner in key.item.every_key())
"""Every key of the groups in lists."""

GROUPS = MappingProxyType({name: member for name, member in ROOT.members.items() if isinstance(member, Group)})
"""Every group of keys by its name."""


def find(path: Sequence[str]) -> Key | Group | None:
    """Give what a place in a configuration is declared as.

    Parameters
    ----------
    path : sequence of str
        Names of groups and keys from the root, and places in lists of groups, counted from 1.

    Returns
    -------
    Key, Group or None
        None where nothing is declared. A place in a list is within `LIST_MAX`, whatever the list's length.
    """
    node: Key | Group | None = ROOT
    for part in path:
        if isinstance(node, Group):
            node = node.members.get(part)
        elif node is not None and node.item is not None and part in _POSITIONS:
            node = node.item
        else:
            return None
    return node


_POSITIONS = frozenset(str(position) for position in range(1, LIST_MAX + 1))


def value_of(parameters: Parameters, name: str) -> Any:
    """Give the value of a dotted key."""
    return operator.attrgetter(name)(parameters)


def _annotation(key: Key) -> Any:
    """Give pydantic's type of a key.

    Strict throughout, so that a text is no number and a switch no 1. Vectors are lists, because YAML has lists only. An
    enumeration is a literal here, because Enum formats the whole of whatever it refuses.
    """
    text = f"{key.text} [{key.unit}]" if key.unit else key.text
    kind: Any
    if key.item is not None:
        kind = model_of(key.item)
    elif key.low is not None:
        kind = Annotated[key.component, Field(ge=key.low, le=key.high, allow_inf_nan=False)]
    elif key.choices:
        kind = Literal.__getitem__(key.choices)
    elif key.type is str:
        kind = Annotated[str, Field(min_length=1, max_length=TEXT_MAX, pattern=r"^[^\x00-\x1f\x7f-\x9f]+$")]
    else:
        kind = key.type
    if key.sizes is not None:
        least, most = key.sizes
        kind = Annotated[list.__class_getitem__(kind), Field(min_length=least, max_length=most)]
    return Annotated[kind, Field(description=text)]


@functools.cache
def model_of(group: Group) -> type[BaseModel]:
    """Derive the pydantic model of a group: the same fields and defaults, plain values.

    It refuses unknown keys, values out of bounds, NaN and infinity, and numbers written as texts or switches.
    """
    fields: dict[str, Any] = {}
    for name, member in group.members.items():
        if isinstance(member, Group):
            fields[name] = (model_of(member), Field(default_factory=model_of(member)))
        else:
            fields[name] = (_annotation(member), plain(member.default))
    model: type[BaseModel] = create_model(
        group.type.__name__,
        __config__=ConfigDict(extra="forbid", strict=True, frozen=True, validate_default=True),
        __doc__=group.type.__doc__,
        **fields,
    )
    return model


def json_schema() -> dict[str, Any]:
    """Give the JSON schema of a configuration file, for editors."""
    schema = model_of(ROOT).model_json_schema()
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **schema, "title": "swingd configuration"}
