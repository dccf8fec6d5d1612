"""The configuration of `swingd cooperate`: a file of its own; everything that is wrong with one is reported at once."""

import difflib
from math import radians
from pathlib import Path
from typing import Annotated, Any, Literal

import yaml
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from swingd.config.draft import Draft, shown
from swingd.config.formation_checks import CHECKS, default_of
from swingd.config.reader import Loader as Loader
from swingd.config.reader import yaml_problem
from swingd.config.source import Source, read_source
from swingd.model.errors import ConfigurationError
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


class _Group(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)


class _Tether(_Group):
    length_m: float = Field(ge=0.05, le=200.0, allow_inf_nan=False)
    anchor_frd_m: _Vec
    length_std_m: float = Field(default_of(RiggedTether, "length_std_m"), ge=1e-4, le=10.0, allow_inf_nan=False)
    winch_gain: _Factor = default_of(RiggedTether, "winch_gain")


class _Vehicle(_Group):
    system_id: _Id
    link: _Url
    tethers: list[_Tether] = Field(min_length=1, max_length=TETHERS_MAX)
    hook_frd_m: _Vec = [0.0, 0.0, 0.0]
    origin_ned_m: _FarVec | None = None
    pos_std_m: float = Field(default_of(RiggedVehicle, "pos_std_m"), ge=1e-4, le=100.0, allow_inf_nan=False)
    vel_std_mps: float = Field(default_of(RiggedVehicle, "vel_std_mps"), ge=1e-4, le=100.0, allow_inf_nan=False)
    direction_std_deg: _Deviation = 1.0
    direction: Literal["swing", "force"] = default_of(RiggedVehicle, "direction").value
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
    system_id: _Id = default_of(FormationParameters, "system_id")
    rate_hz: float = Field(default_of(FormationParameters, "rate_hz"), ge=1.0, le=100.0, allow_inf_nan=False)
    stream_rate_hz: _Rate = default_of(FormationParameters, "stream_rate_hz")
    late_s: float = Field(default_of(FormationParameters, "late_s"), ge=0.02, le=10.0, allow_inf_nan=False)
    lost_s: float = Field(default_of(FormationParameters, "lost_s"), ge=0.05, le=60.0, allow_inf_nan=False)
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
    for check in CHECKS:
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
