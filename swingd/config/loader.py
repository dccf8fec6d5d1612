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
from swingd.config.render import dump_parameters
from swingd.config.schema import GROUPS, KEYS, build, model_of, nested
from swingd.model.errors import ConfigurationError
from swingd.model.parameters import Parameters

__all__ = ["dump_parameters", "load_parameters", "parameters_from_json", "parameters_to_json"]


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
    parameters, refused = _resolve(draft)
    for check in CHECKS:
        # A key that was refused stands at its default, which is not the user's to answer for.
        if refused.isdisjoint(check.keys) and (text := check.find(parameters)):
            place = next((draft.places[key] for key in check.keys if key in draft.places), None)
            draft.refuse(check.keys[0], text, place)
    draft.raise_problems("configuration" if path is None else str(path))
    return parameters


def parameters_to_json(parameters: Parameters) -> str:
    """Write all parameters as one line of JSON; floats keep every bit."""
    return json.dumps(nested(parameters), allow_nan=False, separators=(",", ":"))


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
    parameters, _ = _resolve(draft)
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


def _resolve(draft: Draft) -> tuple[Parameters, set[str]]:
    """Validate the draft and note its problems; gives the refused keys too, which are taken at their defaults."""
    model = model_of(Parameters)
    values = draft.values
    refused: set[str] = set()
    try:
        return build(model.model_validate(values)), refused
    except ValidationError as error:
        for item in error.errors(include_url=False, include_context=False):
            path = _refuse(draft, tuple(map(str, item["loc"])), item["type"], item["input"])
            values = _without(values, path)
            refused |= {name for name, key in KEYS.items() if key.path[: len(path)] == path}
    return build(model.model_validate(values)), refused


def _refuse(draft: Draft, loc: tuple[str, ...], kind: str, value: object) -> tuple[str, ...]:
    """Put one of pydantic's errors in words; gives the path of what it refuses."""
    for length in range(1, len(loc) + 1):
        name = ".".join(loc[:length])
        if name in KEYS:
            # A missing component is reported with the whole vector as its input.
            component = loc[length:] if kind != "missing" else ()
            what = shown(value) + "".join(f" as component {int(index) + 1}" for index in component)
            draft.refuse(name, f"{what} given; expected {KEYS[name].expected}")
            return loc[:length]
    name = ".".join(loc)
    given = f"{shown(value)} given, but it " if name in GROUPS else ""
    draft.refuse(name, given + _not_a_key(name))
    return loc


def _without(values: dict[str, Any], path: tuple[str, ...]) -> dict[str, Any]:
    """Copy nested values without the one at ``path``."""
    head, *rest = path
    if not rest:
        return {key: value for key, value in values.items() if key != head}
    return {**values, head: _without(values[head], tuple(rest))}


_IS_GROUP = "is a group of keys; expected one of them, such as {}"


def _first_of(group: str) -> str:
    return next(name for name in KEYS if name.startswith(f"{group}."))


def _not_a_key(name: str) -> str:
    """Say that a dotted name is a group, or what an unknown one may have meant."""
    if name in GROUPS:
        return _IS_GROUP.format(_first_of(name))
    by_last = {key.rsplit(".", 1)[-1]: key for key in reversed(KEYS)}
    last = name.rsplit(".", 1)[-1]
    candidates = (
        [key for key in KEYS if key.endswith(f".{last}")]
        or difflib.get_close_matches(name, KEYS if "." in name else [*GROUPS, *KEYS], n=2, cutoff=0.7)
        or [by_last[match] for match in difflib.get_close_matches(last, by_last, n=2, cutoff=0.7)]
    )
    if candidates:
        return f"no such key; did you mean {' or '.join(candidates[:3])}?"
    return f"no such key; expected mode or a key of {', '.join(GROUPS)}"
