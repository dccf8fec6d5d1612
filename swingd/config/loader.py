"""Loads configurations and reports everything that is wrong with one at once."""

import difflib
import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import yaml
from pydantic import ValidationError

from swingd.config.checks import CHECKS
from swingd.config.draft import Draft, shown
from swingd.config.gp_model import read_gp_model
from swingd.config.plain import restore
from swingd.config.reader import read_document, read_value, yaml_problem
from swingd.config.schema import GROUPS, ITEM_KEYS, KEYS, LIST_MAX, ROOT, Group, Key, find, model_of
from swingd.config.source import Source, read_source
from swingd.model.errors import ConfigurationError
from swingd.model.parameters import Parameters


def load_parameters(path: Path | str | None = None, overrides: Sequence[str] = ()) -> Parameters:
    """Read a configuration file and apply overrides.

    Parameters
    ----------
    path : Path or str, optional
        YAML in UTF-8. Keys that it leaves out keep their defaults; None reads no file.
    overrides : sequence of str
        ``KEY=VALUE`` each, with a dotted key and a value in YAML; the last one of a key counts. A list of groups is
        given whole, or by its places: ``endpoints.1.shaper=zv``; the place behind the last one makes a new item.

    Returns
    -------
    swingd.model.parameters.Parameters
        Complete, within all bounds, and consistent.

    Raises
    ------
    ConfigurationError
        If the file cannot be read, or with all problems of file and overrides at once, each with its key, its line, the
        value and what was expected.
    """
    return load_source(read_source(path, overrides))


def load_source(source: Source) -> Parameters:
    """Give the parameters that ``source`` says, as `load_parameters` does."""
    draft = read_document(source)
    for override in source.overrides:
        _apply(draft, override)
    parameters = _resolve(draft)
    if not draft.is_refused("gp_ekf.model"):
        try:
            parameters = _with_gp_model(parameters, read_gp_model(parameters, source.folder_of("gp_ekf.model")))
        except ConfigurationError as error:
            draft.refuse("gp_ekf.model", str(error))
    # A key that was refused stands at its default, which is not the user's to answer for.
    for check in [check for check in CHECKS if not any(draft.is_refused(key) for key in check.keys)]:
        if text := check.find(parameters):
            draft.refuse(next((key for key in check.keys if key in draft.places), check.keys[0]), text)
    draft.raise_problems(source.name)
    return parameters


def parameters_from_json(text: str) -> Parameters:
    """Read what `parameters_to_json` wrote.

    Values that do not go together are accepted: a record must replay what was flown. Files that keys name are not
    read: their text is in the record.

    Raises
    ------
    ConfigurationError
        If the text is not a JSON object, or with all keys whose values are out of place.
    """
    try:
        values = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise ConfigurationError(f"parameters: not JSON: {error}") from None
    if not isinstance(values, dict):
        raise ConfigurationError(f"parameters: {shown(values)} given; expected a JSON object of groups of keys")
    gp_ekf = values.get("gp_ekf")
    model_text = gp_ekf.pop("model_text", "") if isinstance(gp_ekf, dict) else ""
    draft = Draft(values)
    parameters = _resolve(draft)
    if not isinstance(model_text, str):
        draft.refuse("gp_ekf.model_text", f"{shown(model_text)} given; expected a text")
    draft.raise_problems("parameters")
    return _with_gp_model(parameters, model_text)


def _with_gp_model(parameters: Parameters, text: str) -> Parameters:
    return replace(parameters, gp_ekf=replace(parameters.gp_ekf, model_text=text))


def _apply(draft: Draft, override: str) -> None:
    """Put one ``KEY=VALUE`` into the draft."""
    name, equals, text = (part.strip() for part in override.partition("="))
    if not equals:
        draft.refuse(name, "no value given; expected KEY=VALUE, such as payload.mass_kg=0.4", "--set")
        return
    path = tuple(name.split("."))
    key = find(path)
    if not isinstance(key, Key):
        draft.refuse(name, _not_a_key(path), "--set")
        return
    try:
        value = read_value(draft, path, text, "--set")
    except (yaml.YAMLError, ValueError) as error:
        draft.refuse(name, f"{shown(text)} given, {yaml_problem(error)}; expected {key.expected}", "--set")
        return
    holder: Any = draft.values
    for depth, part in enumerate(path[:-1], 1):
        if isinstance(holder, list):
            if int(part) > len(holder) + 1:
                count = len(holder)
                draft.refuse(name, f"the list has {count} so far; expected a place from 1 to {count + 1}", "--set")
                return
            if int(part) > len(holder):
                holder.append({})
            holder = holder[int(part) - 1]
        elif isinstance(holder, dict):
            holder = holder.setdefault(part, {} if isinstance(find(path[:depth]), Group) else [])
    # Anything else in the place of a group or list is reported by itself.
    if isinstance(holder, dict):
        holder[path[-1]] = value


def _resolve(draft: Draft) -> Parameters:
    """Validate the draft and note its problems; what is refused takes its default."""
    values = _known(draft, draft.values, ROOT)
    model = model_of(ROOT)
    try:
        validated = model.model_validate(values)
    except ValidationError as error:
        for item in error.errors(include_url=False, include_context=False):
            place = item["loc"]
            depth = 1 + max(index for index, part in enumerate(place) if isinstance(part, str))
            path = tuple(part if isinstance(part, str) else str(part + 1) for part in place[:depth])
            key = find(path)
            assert isinstance(key, Key)
            what = shown(item["input"]) + "".join(f" as component {int(index) + 1}" for index in place[depth:])
            draft.refuse(".".join(path), f"{what} given; expected {key.expected}")
            holder: Any = values
            for part in place[: depth - 1]:
                holder = holder[part]
            holder.pop(place[depth - 1], None)
        validated = model.model_validate(values)
    parameters: Parameters = restore(Parameters, validated.model_dump())
    return parameters


def _known(draft: Draft, values: dict[str, Any], group: Group, path: tuple[str, ...] = ()) -> dict[str, Any]:
    """Copy what ``group`` declares out of the values at ``path``, and note everything else."""
    known: dict[str, Any] = {}
    for part, value in values.items():
        here = (*path, part)
        member = group.members.get(part)
        if isinstance(member, Key):
            known[part] = value if member.item is None else _known_items(draft, value, member, here)
        elif isinstance(member, Group) and isinstance(value, dict):
            known[part] = _known(draft, value, member, here)
        else:
            instead = f"{shown(value)} given, but it " if isinstance(member, Group) else ""
            draft.refuse(".".join(here), instead + _not_a_key(here))
    return known


def _known_items(draft: Draft, values: Any, key: Key, path: tuple[str, ...]) -> list[dict[str, Any]]:
    """Copy what is declared out of the groups of a list; an empty one stands for each that is none."""
    item = key.item
    assert item is not None
    if not isinstance(values, list) or len(values) > LIST_MAX:
        draft.refuse(".".join(path), f"{shown(values)} given; expected {key.expected}")
        return []
    known: list[dict[str, Any]] = []
    for place, value in enumerate(values, 1):
        here = (*path, str(place))
        known.append(_known(draft, value, item, here) if isinstance(value, dict) else {})
        if not isinstance(value, dict):
            first = next(iter(item.every_key()))
            example = f"such as {{{first.path[-1]}: {first.default}}}"
            draft.refuse(".".join(here), f"{shown(value)} given; expected a group of keys, {example}")
    return known


def _not_a_key(path: tuple[str, ...]) -> str:
    """Say what a name that is no key in its place may have meant."""
    name = ".".join(path)
    path = tuple(name.split("."))
    *outer, last = path
    declared, group = find(path), find(outer)
    if isinstance(declared, Group):
        return f"is a group of keys; expected one of them, such as {name}.{next(iter(declared.members))}"
    if declared is not None:
        return f"no such key at this level; expected {last} inside {'.'.join(outer)}"
    # In a list, what is near is in the same place of it.
    place = outer[-1] if isinstance(group, Group) and group.path[-1:] == ("N",) else "1"
    names = [key.name.replace(".N.", f".{place}.") for key in (*KEYS.values(), *ITEM_KEYS)]
    by_last = {key.rpartition(".")[2]: key for key in reversed(names)}
    if outer and isinstance(group, Group):
        near = [".".join((*outer, match)) for match in difflib.get_close_matches(last, group.members, n=2, cutoff=0.6)]
    else:
        near = difflib.get_close_matches(name, names if outer else [*GROUPS, *names], n=2, cutoff=0.7)
    candidates = (
        [key for key in names if key.rpartition(".")[2] == last]
        or near
        or [by_last[match] for match in difflib.get_close_matches(last, by_last, n=2, cutoff=0.7)]
    )
    if candidates:
        return f"no such key; did you mean {' or '.join(candidates[:3])}?"
    if outer and isinstance(group, Group):
        return f"no such key; expected one of {', '.join(group.members)}"
    single = ", ".join(key for key in KEYS if "." not in key)
    return f"no such key; expected {single} or a key of {', '.join(GROUPS)}"
