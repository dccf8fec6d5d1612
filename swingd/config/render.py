"""Writes parameters as commented YAML, and the reference of all keys; every text comes from the declarations."""

from collections.abc import Mapping
from typing import Any

import yaml

from swingd.config.schema import GROUPS, KEYS, Key, plain, value_of
from swingd.model.parameters import Parameters

_UNLIMITED = 2**31
"""Line width at which PyYAML never wraps."""


def dump_parameters(parameters: Parameters, head: str = "", notes: Mapping[str, str] | None = None) -> str:
    """Write all parameters as YAML that `load_parameters` reads back as the same values.

    Parameters
    ----------
    parameters : swingd.model.parameters.Parameters
        Every key is written, with a line above that gives its meaning, unit and range.
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
    lines: list[str] = []
    group = ""
    for key in KEYS.values():
        if key.path[0] in GROUPS and key.path[0] != group:
            blocks.append(lines)
            group = key.path[0]
            lines = [f"# {GROUPS[group]}", f"{group}:"]
        indent = "  " * (len(key.path) - 1)
        note = f"  # {notes[key.name]}" if key.name in notes else ""
        lines.append(f"{indent}# {_comment(key)}")
        lines.append(f"{indent}{key.path[-1]}: {yaml_text(value_of(parameters, key.name))}{note}")
    blocks.append(lines)
    return "\n\n".join("\n".join(block) for block in blocks if block) + "\n"


def yaml_text(value: Any) -> str:
    """Write one value as YAML on one line."""
    value = plain(value)
    # Quotes keep a free text from being read as a number; PyYAML's own rule is that of YAML 1.1.
    style = '"' if isinstance(value, str) and not value.isidentifier() else None
    text: str = yaml.safe_dump(
        [value], default_flow_style=True, default_style=style, width=_UNLIMITED, allow_unicode=True
    )
    return text.strip()[1:-1]


def _comment(key: Key) -> str:
    limits = ", ".join(part for part in (key.unit, key.range) if part)
    return f"{key.text} [{limits}]" if limits and key.low is not None else key.text


def markdown_tables() -> str:
    """Write the reference of all keys: one table per group."""
    parts: list[str] = []
    group = None
    for key in KEYS.values():
        name = key.path[0] if len(key.path) > 1 else ""
        if name != group:
            group = name
            title = f"## `{group}`\n\n{GROUPS[group]}" if group else "## Top level"
            parts.append(f"\n{title}\n\n| key | default | unit | range | meaning |\n|---|---|---|---|---|")
        default = f"`{yaml_text(key.default)}`"
        cells = (f"`{key.name}`", default, key.unit, key.range, key.text)
        parts.append("| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |")
    return "\n".join(parts).lstrip("\n") + "\n"
