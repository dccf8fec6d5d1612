"""The configuration of `swingd cooperate`: a file of its own; everything that is wrong with one is reported at once."""

import dataclasses
import difflib
from collections.abc import Iterator
from math import radians
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import yaml
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from swingd.config.draft import Draft, shown
from swingd.config.reader import _Loader as Loader
from swingd.config.reader import yaml_problem
from swingd.config.source import Source, read_source
from swingd.estimation.cooperative_pose import WinchTable
from swingd.link.url import LOOPBACK, LinkUrl, SerialPort, TcpIn, UdpIn, parse_url
from swingd.model.errors import ConfigurationError, LinkUrlError
from swingd.model.formation import (
    TETHERS_MAX,
    VEHICLES_MAX,
    VEHICLES_MIN,
    DirectionSource,
    FormationParameters,
    RiggedTether,
    RiggedVehicle,
    SharedLoad,
)

OUTPUTS_MAX = 8
ROWS_MAX = 64
_SEPARATE_M = 1e-3
"""Anchors nearer to one line than this lie on it."""

_Far = Annotated[float, Field(ge=-1e4, le=1e4, allow_inf_nan=False)]
_Near = Annotated[float, Field(ge=-100.0, le=100.0, allow_inf_nan=False)]
_Angle = Annotated[float, Field(ge=-80.0, le=80.0, allow_inf_nan=False)]
_Deviation = Annotated[float, Field(ge=0.01, le=90.0, allow_inf_nan=False)]
_Factor = Annotated[float, Field(ge=-1e3, le=1e3, allow_inf_nan=False)]
_Id = Annotated[int, Field(ge=1, le=255)]
_Rate = Annotated[float, Field(ge=0.0, le=200.0, allow_inf_nan=False)]
_Url = Annotated[str, Field(min_length=1, max_length=200)]
_Vec = Annotated[list[_Near], Field(min_length=3, max_length=3)]
_FarVec = Annotated[list[_Far], Field(min_length=3, max_length=3)]
_Row = Annotated[list[_Factor], Field(min_length=2, max_length=2)]


def _default(group: type[Any], name: str) -> Any:
    """Give what a dataclass of `swingd.model.formation` declares, so that it stands once."""
    return next(field.default for field in dataclasses.fields(group) if field.name == name)


class _Group(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)


class _Tether(_Group):
    length_m: float = Field(ge=0.05, le=200.0, allow_inf_nan=False)
    anchor_frd_m: _Vec
    length_std_m: float = Field(_default(RiggedTether, "length_std_m"), ge=1e-4, le=10.0, allow_inf_nan=False)
    winch_gain: _Factor = _default(RiggedTether, "winch_gain")


class _Vehicle(_Group):
    system_id: _Id
    link: _Url
    tethers: list[_Tether] = Field(min_length=1, max_length=TETHERS_MAX)
    hook_frd_m: _Vec = [0.0, 0.0, 0.0]
    origin_ned_m: _FarVec | None = None
    pos_std_m: float = Field(_default(RiggedVehicle, "pos_std_m"), ge=1e-4, le=100.0, allow_inf_nan=False)
    vel_std_mps: float = Field(_default(RiggedVehicle, "vel_std_mps"), ge=1e-4, le=100.0, allow_inf_nan=False)
    direction_std_deg: _Deviation = 1.0
    direction: Literal["swing", "force"] = _default(RiggedVehicle, "direction").value
    winch: Annotated[str, Field(min_length=1, max_length=10)] | None = None


class _Load(_Group):
    roll_deg: _Angle = 0.0
    roll_std_deg: _Deviation | None = None
    pitch_deg: _Angle = 0.0
    pitch_std_deg: _Deviation | None = None
    winch_pitch: list[_Row] = Field([], max_length=ROWS_MAX)


class _Formation(_Group):
    vehicles: list[_Vehicle] = Field(min_length=VEHICLES_MIN, max_length=VEHICLES_MAX)
    load: _Load = Field(default_factory=lambda: _Load.model_validate({}))
    outputs: list[_Url] = Field([], max_length=OUTPUTS_MAX)
    system_id: _Id = _default(FormationParameters, "system_id")
    rate_hz: float = Field(_default(FormationParameters, "rate_hz"), ge=1.0, le=100.0, allow_inf_nan=False)
    stream_rate_hz: _Rate = _default(FormationParameters, "stream_rate_hz")
    late_s: float = Field(_default(FormationParameters, "late_s"), ge=0.02, le=10.0, allow_inf_nan=False)
    lost_s: float = Field(_default(FormationParameters, "lost_s"), ge=0.05, le=60.0, allow_inf_nan=False)
    record: Annotated[str, Field(min_length=1, max_length=200)] | None = None


_ITEMS: dict[str, type[_Group]] = {"vehicles": _Vehicle, "tethers": _Tether, "load": _Load}
"""The group that stands under a name, once or in a list."""


def load_formation(path: Path | str) -> FormationParameters:
    """Read the configuration file of several vehicles with one load.

    Raises
    ------
    ConfigurationError
        If the file cannot be read, or with all its problems, each with its key, its line, the value and what was
        expected.
    """
    source = read_source(path, ())
    draft = _read(source)
    formation = _validate(draft)
    for check in (_ids, _links, _origins, _ages, _winches, _anchors):
        for name, text in check(draft.values):
            draft.refuse(name, text)
    draft.raise_problems(source.name)
    assert formation is not None
    return _parameters(formation)


# ---- reading


def _read(source: Source) -> Draft:
    try:
        text = source.content.decode("utf-8-sig")
    except UnicodeDecodeError:
        raise ConfigurationError(f"{source.name}: not UTF-8; expected YAML in UTF-8") from None
    draft = Draft()
    try:
        loader = Loader(text)
        root = loader.get_single_node()
        values = {} if root is None else _walk(draft, loader, root, (), set())
    except (yaml.YAMLError, ValueError) as error:
        raise ConfigurationError(f"{source.name}: {yaml_problem(error)}") from None
    if isinstance(values, dict):
        draft.values = values
    else:
        draft.refuse("the file", f"{shown(values)} given; expected keys, such as vehicles:")
    return draft


def _walk(draft: Draft, loader: Any, node: yaml.Node, path: tuple[str, ...], seen: set[int]) -> Any:
    """Construct plain values, noting the line of every key and item.

    Nothing is walked twice: aliases within aliases could be larger than any memory.
    """
    if isinstance(node, yaml.CollectionNode):
        if id(node) in seen:
            draft.refuse(".".join(path), "an alias of a group or list; expected it written out")
            return None
        seen.add(id(node))
    if isinstance(node, yaml.MappingNode):
        group: dict[str, Any] = {}
        for key_node, value_node in node.value:
            key, line = str(getattr(key_node, "value", "?")), key_node.start_mark.line + 1
            name = ".".join((*path, key))
            if key in group:
                draft.refuse(name, f"given again, first on line {draft.places[name]}; expected each key once", line)
            draft.places[name] = line
            group[key] = _walk(draft, loader, value_node, (*path, key), seen)
        return group
    if isinstance(node, yaml.SequenceNode):
        items = []
        for place, item in enumerate(node.value, 1):
            draft.places[".".join((*path, str(place)))] = item.start_mark.line + 1
            items.append(_walk(draft, loader, item, (*path, str(place)), seen))
        return items
    return loader.construct_object(node, deep=True)


def _validate(draft: Draft) -> _Formation | None:
    try:
        return _Formation.model_validate(draft.values)
    except ValidationError as error:
        for item in error.errors(include_url=False, include_context=False):
            path = tuple(str(part + 1) if isinstance(part, int) else part for part in item["loc"])
            name = ".".join(path)
            if item["type"] == "extra_forbidden":
                draft.refuse(name, _no_such_key(path))
            elif item["type"] == "missing":
                draft.refuse(name, "missing; expected in every such group")
            else:
                wanted = item["msg"].removeprefix("Input should ").removeprefix("have ").removeprefix("be ")
                draft.refuse(name, f"{shown(item['input'])} given; expected {wanted[:1].lower() + wanted[1:]}")
    return None


def _no_such_key(path: tuple[str, ...]) -> str:
    *outer, last = path
    names = [part for part in outer if not part.isdigit()]
    members = list((_ITEMS[names[-1]] if names else _Formation).model_fields)
    near = difflib.get_close_matches(last, members, n=2, cutoff=0.6)
    if near:
        return f"no such key; did you mean {' or '.join(near)}?"
    return f"no such key; expected one of {', '.join(members)}"


# ---- what does not go together; on values that may be anything


def _groups(values: Any, name: str) -> Iterator[tuple[str, dict[str, Any]]]:
    """Give every group of a list, with its dotted name."""
    items = values.get(name) if isinstance(values, dict) else None
    for place, item in enumerate(items if isinstance(items, list) else (), 1):
        if isinstance(item, dict):
            yield f"{name}.{place}", item


def _ids(values: Any) -> Iterator[tuple[str, str]]:
    seen: dict[int, str] = {}
    for name, vehicle in _groups(values, "vehicles"):
        system_id = vehicle.get("system_id")
        if isinstance(system_id, int):
            if system_id in seen:
                yield f"{name}.system_id", f"{system_id} given, as in {seen[system_id]}; expected one of its own"
            seen.setdefault(system_id, name)
    own = values.get("system_id", _default(FormationParameters, "system_id"))
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
        what = _taken(url)
        if not shared and what is not None:
            if what in taken:
                yield name, f"{url} takes {what}, as {taken[what]} does; expected one of its own, or the same URL"
            taken.setdefault(what, name)
        urls.setdefault(str(url), name)


def _taken(url: LinkUrl) -> str | None:
    """Name what only one link can have."""
    match url:
        case UdpIn(port=port) if port:
            return f"UDP port {port}"
        case TcpIn(port=port) if port:
            return f"TCP port {port}"
        case SerialPort(device=device):
            return device
    return None


def _origins(values: Any) -> Iterator[tuple[str, str]]:
    vehicles = list(_groups(values, "vehicles"))
    without = [name for name, vehicle in vehicles if vehicle.get("origin_ned_m") is None]
    if without and len(without) < len(vehicles):
        yield f"{without[0]}.origin_ned_m", "not given, but others have one; expected one for every vehicle or for none"


def _ages(values: Any) -> Iterator[tuple[str, str]]:
    late = values.get("late_s", _default(FormationParameters, "late_s"))
    lost = values.get("lost_s", _default(FormationParameters, "lost_s"))
    if isinstance(late, int | float) and isinstance(lost, int | float) and not late < lost:
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
    if all(isinstance(row, list) and len(row) == 2 and all(type(x) in (int, float) for x in row) for row in rows):
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
    is_whole = all(
        isinstance(anchor, list) and len(anchor) == 3 and all(type(x) in (int, float) for x in anchor)
        for anchor in anchors
    )
    if len(anchors) < VEHICLES_MIN or not is_whole:
        return
    spread = np.array(anchors, dtype=float)
    if not np.isfinite(spread).all():
        return
    if np.linalg.svd(spread - spread.mean(axis=0), compute_uv=False)[1] < _SEPARATE_M:
        yield (
            "load",
            "all anchors lie on one line, and nothing tells the turn about it; expected pitch_std_deg or roll_std_deg",
        )


def _parameters(formation: _Formation) -> FormationParameters:
    def vec(values: list[float]) -> tuple[float, float, float]:
        x, y, z = map(float, values)
        return x, y, z

    load = formation.load
    return FormationParameters(
        vehicles=tuple(
            RiggedVehicle(
                system_id=vehicle.system_id,
                link=vehicle.link,
                tethers=tuple(
                    RiggedTether(tether.length_m, vec(tether.anchor_frd_m), tether.length_std_m, tether.winch_gain)
                    for tether in vehicle.tethers
                ),
                hook_frd_m=vec(vehicle.hook_frd_m),
                origin_ned_m=None if vehicle.origin_ned_m is None else vec(vehicle.origin_ned_m),
                pos_std_m=vehicle.pos_std_m,
                vel_std_mps=vehicle.vel_std_mps,
                direction_std_rad=radians(vehicle.direction_std_deg),
                direction=DirectionSource(vehicle.direction),
                winch=vehicle.winch or "",
            )
            for vehicle in formation.vehicles
        ),
        load=SharedLoad(
            roll_rad=radians(load.roll_deg),
            roll_std_rad=None if load.roll_std_deg is None else radians(load.roll_std_deg),
            pitch_rad=radians(load.pitch_deg),
            pitch_std_rad=None if load.pitch_std_deg is None else radians(load.pitch_std_deg),
            winch_pitch=tuple((float(winch), radians(pitch)) for winch, pitch in load.winch_pitch),
        ),
        outputs=tuple(formation.outputs),
        system_id=formation.system_id,
        rate_hz=formation.rate_hz,
        stream_rate_hz=formation.stream_rate_hz,
        late_s=formation.late_s,
        lost_s=formation.lost_s,
        record=formation.record or "",
    )
