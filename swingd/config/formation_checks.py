"""What does not go together in the configuration of several vehicles; looked at in values that may be anything."""

import dataclasses
from collections.abc import Iterator
from typing import Any

import numpy as np

from swingd.estimation.cooperative_pose import WinchTable
from swingd.link.url import LOOPBACK, parse_url, taken_by
from swingd.model.errors import ConfigurationError, LinkUrlError
from swingd.model.formation import VEHICLES_MIN, FormationParameters

_NUMBER_MAX = 1e9
_SEPARATE_M = 1e-3
"""Anchors nearer to one line than this lie on it."""


def default_of(group: type[Any], name: str) -> Any:
    """Give what a dataclass of `swingd.model.formation` declares, so that it stands once."""
    return next(field.default for field in dataclasses.fields(group) if field.name == name)


def _groups(values: Any, name: str) -> Iterator[tuple[str, dict[str, Any]]]:
    """Give every group of a list, with its dotted name."""
    items = values.get(name) if isinstance(values, dict) else None
    for place, item in enumerate(items if isinstance(items, list) else (), 1):
        if isinstance(item, dict):
            yield f"{name}.{place}", item


def _is_number(value: Any) -> bool:
    """Whether it is one that the schema may take; whole numbers in YAML have no bound."""
    return type(value) in (int, float) and -_NUMBER_MAX <= value <= _NUMBER_MAX


def _ids(values: Any) -> Iterator[tuple[str, str]]:
    seen: dict[int, str] = {}
    for name, vehicle in _groups(values, "vehicles"):
        system_id = vehicle.get("system_id")
        if isinstance(system_id, int):
            if system_id in seen:
                yield f"{name}.system_id", f"{system_id} given, as in {seen[system_id]}; expected one of its own"
            seen.setdefault(system_id, name)
    own = values.get("system_id", default_of(FormationParameters, "system_id"))
    if isinstance(own, int) and own in seen:
        yield "system_id", f"{own} given, as in {seen[own]}; expected one that no vehicle has"


def _links(values: Any) -> Iterator[tuple[str, str]]:
    urls: dict[str, str] = {}
    taken: dict[str, str] = {}
    listed = values.get("outputs")
    outputs = enumerate(listed if isinstance(listed, list) else (), 1)
    given = [(f"{name}.link", vehicle.get("link")) for name, vehicle in _groups(values, "vehicles")]
    given += [(f"outputs.{place}", url) for place, url in outputs]
    for name, text in given:
        if not isinstance(text, str) or not text:
            continue
        try:
            url = parse_url(text, LOOPBACK)
        except LinkUrlError as error:
            yield name, str(error)
            continue
        shared = name.startswith("vehicles") and urls.get(str(url), "").startswith("vehicles")
        what = taken_by(url)
        if not shared and what is not None:
            if what in taken:
                yield name, f"{url} takes {what}, as {taken[what]} does; expected one of its own, or the same URL"
            taken.setdefault(what, name)
        urls.setdefault(str(url), name)


def _origins(values: Any) -> Iterator[tuple[str, str]]:
    vehicles = list(_groups(values, "vehicles"))
    without = [name for name, vehicle in vehicles if vehicle.get("origin_ned_m") is None]
    if without and len(without) < len(vehicles):
        yield f"{without[0]}.origin_ned_m", "not given, but others have one; expected one for every vehicle or for none"


def _ages(values: Any) -> Iterator[tuple[str, str]]:
    late = values.get("late_s", default_of(FormationParameters, "late_s"))
    lost = values.get("lost_s", default_of(FormationParameters, "lost_s"))
    if _is_number(late) and _is_number(lost) and not late < lost:
        yield "late_s", f"{late:g} s given; expected less than lost_s, {lost:g} s"


def _winches(values: Any) -> Iterator[tuple[str, str]]:
    named = False
    for name, vehicle in _groups(values, "vehicles"):
        gains = [tether.get("winch_gain", 0.0) for _, tether in _groups(vehicle, "tethers")]
        winch = vehicle.get("winch")
        named |= winch is not None
        if any(gains) and winch is None:
            yield f"{name}.tethers", "a winch_gain without a winch; expected winch, the name of its NAMED_VALUE_FLOAT"
    load = values.get("load")
    rows = load.get("winch_pitch") if isinstance(load, dict) else None
    if not isinstance(load, dict) or not isinstance(rows, list) or not rows:
        return
    if not named:
        yield "load.winch_pitch", "given, but no vehicle has a winch; expected vehicles.N.winch"
    if load.get("pitch_std_deg") is None:
        yield "load.pitch_std_deg", "not given; expected how well winch_pitch tells the pitch"
    if all(isinstance(row, list) and len(row) == 2 and all(map(_is_number, row)) for row in rows):
        try:
            WinchTable([row[0] for row in rows], [row[1] for row in rows])
        except ConfigurationError as error:
            yield "load.winch_pitch", str(error)


def _anchors(values: Any) -> Iterator[tuple[str, str]]:
    """Refuse anchors on one line where nothing tells the turn about it."""
    load = values.get("load")
    if isinstance(load, dict) and any(load.get(name) is not None for name in ("roll_std_deg", "pitch_std_deg")):
        return
    anchors = [
        tether.get("anchor_frd_m")
        for _, vehicle in _groups(values, "vehicles")
        for _, tether in _groups(vehicle, "tethers")
    ]
    is_whole = all(isinstance(anchor, list) and len(anchor) == 3 and all(map(_is_number, anchor)) for anchor in anchors)
    if len(anchors) < VEHICLES_MIN or not is_whole:
        return
    spread = np.array(anchors, dtype=float)
    if np.linalg.svd(spread - spread.mean(axis=0), compute_uv=False)[1] < _SEPARATE_M:
        yield (
            "load",
            "all anchors lie on one line, and nothing tells the turn about it; expected pitch_std_deg or roll_std_deg",
        )


CHECKS = (_ids, _links, _origins, _ages, _winches, _anchors)
"""Each takes the values of a file and gives dotted keys with what is wrong with them."""
