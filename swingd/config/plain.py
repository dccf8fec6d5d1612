"""Parameters as nested plain values, and back; without pydantic, so that the daemon starts fast."""

import dataclasses
import json
import math
from enum import Enum
from typing import Any, get_args, get_origin, get_type_hints

from swingd.model.parameters import CONTENT_OF, Parameters


def plain(value: Any) -> Any:
    """Give ``value`` as YAML and JSON write it: mappings for groups, lists, texts and numbers."""
    if dataclasses.is_dataclass(value):
        members = {field: getattr(value, field.name) for field in dataclasses.fields(value)}
        # What a file says, where none is named, is nothing to write.
        return {
            field.name: plain(member) for field, member in members.items() if member or CONTENT_OF not in field.metadata
        }
    if isinstance(value, tuple):
        return [plain(item) for item in value]
    return value.value if isinstance(value, Enum) else value


def restore(kind: Any, value: Any) -> Any:
    """Give what `plain` turned into ``value``.

    Parameters
    ----------
    kind : type
        A dataclass of `swingd.model.parameters`, or the type of one of its fields.
    value : object
        Anything. Types are held strictly, bounds are not looked at.

    Raises
    ------
    ValueError
        If no value of ``kind`` is written like this: a field is missing or unknown, a type is another, a number is not
        finite.
    """
    if dataclasses.is_dataclass(kind):
        types = get_type_hints(kind)
        contents = {field.name for field in dataclasses.fields(kind) if CONTENT_OF in field.metadata}
        names = [field.name for field in dataclasses.fields(kind)]
        if type(value) is not dict or not set(names) - contents <= value.keys() <= set(names):
            raise ValueError(f"a mapping of {', '.join(names)} is expected")
        return kind(**{name: restore(types[name], value[name]) for name in names if name in value})  # type: ignore[operator]
    if get_origin(kind) is tuple:
        first, *others = get_args(kind)
        if type(value) is not list or (others != [...] and len(value) != 1 + len(others)):
            raise ValueError(f"a list is expected, {kind}")
        return tuple(restore(first, item) for item in value)
    if issubclass(kind, Enum):
        return kind(value)
    if type(value) is not kind or (kind is float and not math.isfinite(value)):
        raise ValueError(f"{kind.__name__} is expected")
    return value


def parameters_to_json(parameters: Parameters) -> str:
    """Write all parameters as one line of JSON; floats keep every bit."""
    return json.dumps(plain(parameters), allow_nan=False, separators=(",", ":"))
