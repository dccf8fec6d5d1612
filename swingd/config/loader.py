"""Loads configurations and reports everything that is wrong with one at once."""

import difflib
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import yaml
from pydantic import ValidationError

from swingd.config.checks import CHECKS
from swingd.config.draft import Draft, shown
from swingd.config.reader import read_file, read_value, yaml_problem
from swingd.config.schema import GROUPS, KEYS, Key, build, model_of
from swingd.model.errors import ConfigurationError
from swingd.model.parameters import Parameters


def load_parameters(path: Path | str | None = None, overrides: Sequence[str] = ()) -> Parameters:
    """Read a configuration file and apply overrides.

    Parameters
    ----------
    path : Path or str, optional
        YAML in UTF-8. Keys that it leaves out keep their defaults; None reads no file.
    overrides : sequence of str
        ``KEY=VALUE`` each, with a dotted key and a value in YAML; the last one of a key counts.

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
    draft = Draft() if path is None else read_file(Path(path))
    for override in overrides:
        _apply(draft, override)
    parameters = _resolve(draft)
    # A key that was refused stands at its default, which is not the user's to answer for.
    refused = {name for name in KEYS if draft.refused & {name, KEYS[name].path[0]}}
    for check in CHECKS:
        if refused.isdisjoint(check.keys) and (text := check.find(parameters)):
            draft.refuse(next((key for key in check.keys if key in draft.places), check.keys[0]), text)
    draft.raise_problems("configuration" if path is None else str(path))
    return parameters


def parameters_from_json(text: str) -> Parameters:
    """Read what `parameters_to_json` wrote.

    Values that do not go together are accepted: a record must replay what was flown.

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
    draft = Draft(values)
    parameters = _resolve(draft)
    draft.raise_problems("parameters")
    return parameters


def _apply(draft: Draft, override: str) -> None:
    """Put one ``KEY=VALUE`` into the draft."""
    name, equals, text = (part.strip() for part in override.partition("="))
    if not equals:
        draft.refuse(name, "no value given; expected KEY=VALUE, such as payload.mass_kg=0.4", "--set")
        return
    if name not in KEYS:
        draft.refuse(name, _not_a_key(name), "--set")
        return
    try:
        value = read_value(text)
    except (yaml.YAMLError, ValueError) as error:
        draft.refuse(name, f"{shown(text)} given, {yaml_problem(error)}; expected {KEYS[name].expected}", "--set")
        return
    *groups, last = KEYS[name].path
    group = draft.values
    for part in groups:
        group = group.setdefault(part, {})
        if not isinstance(group, dict):
            return  # The file has something else in place of the group, which is reported by itself.
    group[last] = value
    draft.places[name] = "--set"


def _resolve(draft: Draft) -> Parameters:
    """Validate the draft and note its problems; what is refused takes its default."""
    values = _known(draft, draft.values, ())
    model = model_of(Parameters)
    try:
        return build(model.model_validate(values))
    except ValidationError as error:
        for item in error.errors(include_url=False, include_context=False):
            key = next(key for key in KEYS.values() if key.path == item["loc"][: len(key.path)])
            # A missing component is reported with the whole vector as its input.
            component = item["loc"][len(key.path) :] if item["type"] != "missing" else ()
            what = shown(item["input"]) + "".join(f" as component {int(index) + 1}" for index in component)
            draft.refuse(key.name, f"{what} given; expected {key.expected}")
            _group(values, key).pop(key.path[-1], None)
    return build(model.model_validate(values))


def _known(draft: Draft, values: dict[str, Any], path: tuple[str, ...]) -> dict[str, Any]:
    """Copy the groups and keys of the schema out of nested values, and note all others."""
    known: dict[str, Any] = {}
    for part, value in values.items():
        name = ".".join((*path, part))
        if name in GROUPS and isinstance(value, dict):
            known[part] = _known(draft, value, (*path, part))
        elif name in KEYS and KEYS[name].path == (*path, part):
            known[part] = value
        else:
            draft.refuse(
                name, f"{shown(value)} given, but it {_not_a_key(name)}" if name in GROUPS else _not_a_key(name)
            )
    return known


def _group(values: dict[str, Any], key: Key) -> dict[str, Any]:
    """Give the mapping of nested values that holds ``key``."""
    for part in key.path[:-1]:
        values = values[part]
    return values


def _not_a_key(name: str) -> str:
    """Say what a dotted name that is no key in its place may have meant."""
    group, _, last = name.rpartition(".")
    siblings = [key.path[-1] for key in KEYS.values() if key.path[:-1] == ((group or name),)]
    if name in GROUPS:
        return f"is a group of keys; expected one of them, such as {name}.{siblings[0]}"
    if name in KEYS:
        return f"no such key at this level; expected {last} inside {group}"
    by_last = {key.path[-1]: key.name for key in reversed(list(KEYS.values()))}
    candidates = (
        [key.name for key in KEYS.values() if key.path[-1] == last]
        or difflib.get_close_matches(name, KEYS if group else [*GROUPS, *KEYS], n=2, cutoff=0.7)
        or [by_last[match] for match in difflib.get_close_matches(last, by_last, n=2, cutoff=0.7)]
    )
    if candidates:
        return f"no such key; did you mean {' or '.join(candidates[:3])}?"
    if group in GROUPS:
        return f"no such key; expected one of {', '.join(siblings)}"
    return f"no such key; expected mode or a key of {', '.join(GROUPS)}"
