"""Writes parameters as commented YAML, and the reference of all keys; every text comes from the declarations."""

from collections.abc import Iterable, Iterator, Mapping
from typing import Any

import yaml

from swingd.config.plain import plain
from swingd.config.schema import ROOT, Group, Key
from swingd.model.parameters import Parameters

_UNLIMITED = 2**31
"""Line width at which PyYAML never wraps."""


class _Dumper(yaml.SafeDumper):
    """Quotes what a free text may be taken for: PyYAML's own rule is that of YAML 1.1."""


_Dumper.add_representer(
    str,
    lambda dumper, text: dumper.represent_scalar(
        "tag:yaml.org,2002:str", text, style=None if text.isidentifier() else '"'
    ),
)


def dump_parameters(parameters: Parameters, head: str = "", notes: Mapping[str, str] | None = None) -> str:
    """Write all parameters as YAML that `load_parameters` reads back as the same values.

    Parameters
    ----------
    parameters : swingd.model.parameters.Parameters
        Every key is written, with a line above that gives its meaning, unit and range; for the groups of a list, these
        lines stand once, above the list.
    head : str
        Comment at the top, printable, without the number signs.
    notes : mapping of str to str, optional
        By dotted key: a comment behind the value, such as where it was measured.

    Returns
    -------
    str
        Ends with a line break.
    """
    notes = notes or {}
    blocks = [[f"# {line}".rstrip() for line in head.splitlines()]] if head else []
    for name, member in ROOT.members.items():
        value = getattr(parameters, name)
        if isinstance(member, Group):
            lines = [
                line for key in member.every_key() for line in _key_lines(key, getattr(value, key.path[-1]), notes)
            ]
            blocks.append([f"# {member.text}", f"{name}:", *(f"  {line}" for line in lines)])
        elif member.item is None or not value:
            blocks.append(_key_lines(member, value, notes))
        else:
            blocks.append([*_comments(member), f"{name}:", *_item_lines(member.item, value, name, notes)])
    return "\n\n".join("\n".join(block) for block in blocks) + "\n"


def yaml_text(value: Any) -> str:
    """Write one value as YAML on one line."""
    text: str = yaml.dump(
        [plain(value)], Dumper=_Dumper, default_flow_style=True, width=_UNLIMITED, allow_unicode=True, sort_keys=False
    )
    return text.strip()[1:-1]


def markdown_tables() -> str:
    """Write the reference of all keys: one table per group, and the keys at the top in one."""
    top = [member for member in ROOT.members.values() if isinstance(member, Key) and member.item is None]
    parts = [f"## Top level\n\n{_table(top)}"]
    for member in ROOT.members.values():
        if isinstance(member, Group):
            parts.append(f"## `{member.name}`\n\n{member.text}\n\n{_table(member.every_key())}")
        elif member.item is not None:
            about = f"{_sentence(member.text)} {_sentence(member.expected)} `N` is the place in the list, from 1."
            parts.append(f"## `{member.name}`\n\n{about}\n\n{_table(member.item.every_key())}")
    return "\n\n".join(parts) + "\n"


def _key_lines(key: Key, value: Any, notes: Mapping[str, str]) -> list[str]:
    return [*_comments(key), _value_line(key, value, notes.get(key.name))]


def _item_lines(item: Group, values: Iterable[Any], name: str, notes: Mapping[str, str]) -> Iterator[str]:
    for place, value in enumerate(values, 1):
        for index, key in enumerate(item.every_key()):
            part = key.path[-1]
            line = _value_line(key, getattr(value, part), notes.get(f"{name}.{place}.{part}"))
            yield f"    {line}" if index else f"  - {line}"


def _value_line(key: Key, value: Any, note: str | None) -> str:
    return f"{key.path[-1]}: {yaml_text(value)}" + (f"  # {note}" if note else "")


def _comments(key: Key) -> list[str]:
    """Give the lines above a key; a list's say what stands in each of its groups."""
    inner = () if key.item is None else key.item.every_key()
    return [f"# {_comment(key)}", *(f"#   {part.path[-1]}: {_comment(part)}" for part in inner)]


def _comment(key: Key) -> str:
    limits = ", ".join(part for part in (key.unit, key.range) if part)
    return f"{key.text} [{limits}]" if limits and key.low is not None else key.text


def _table(keys: Iterable[Key]) -> str:
    """Write one table; a column more names the parameters of the PARAM protocol, where there are any."""
    keys = list(keys)
    columns = ["key", "default", "unit", "range", "meaning"]
    rows = [[f"`{key.name}`", f"`{yaml_text(key.default)}`", key.unit, key.range, key.text] for key in keys]
    if any(key.mavlink for key in keys):
        columns.append("parameter")
        rows = [[*row, key.mavlink and f"`{key.mavlink}`"] for row, key in zip(rows, keys, strict=True)]
    head, *body = ("| " + " | ".join(cell.replace("|", "\\|") for cell in line) + " |" for line in (columns, *rows))
    return "\n".join([head, "|" + "---|" * len(columns), *body])


def _sentence(text: str) -> str:
    return f"{text[0].upper()}{text[1:]}."
