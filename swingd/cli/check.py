"""``swingd check``."""

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from swingd.cli import options

if TYPE_CHECKING:
    from swingd.config.schema import Group, Key
    from swingd.control.summary import Correction, HoverPoint, Oscillation, Summary
    from swingd.model.parameters import Parameters

EXAMPLES = """\b
Examples:
  swingd check configs/x500.yaml
  swingd check configs/x500.yaml --set payload.mass_kg=0.4 --set 'hold.vel_ned_mps=[1, 0, 0]'
  swingd check configs/inline.yaml --set endpoints.1.shaper=zvd
  swingd check configs/x500.yaml --json
"""


def check(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="Configuration in YAML.")],
    overrides: options.Overrides = None,
    as_json: options.Json = False,
) -> None:
    """Validate a configuration; print the resolved parameters and what follows from them."""
    # Imported here, so that the other commands and --help start without them.
    from swingd.config.draft import printable
    from swingd.config.loader import load_parameters
    from swingd.control.summary import summarise

    parameters = load_parameters(file, overrides or ())
    summary = summarise(parameters)
    if as_json:
        typer.echo(json.dumps(_as_json(file, parameters, summary), allow_nan=False))
        return
    typer.echo(f"{printable(str(file))}: valid; * marks what differs from the default")
    typer.echo("\n".join([*_parameter_lines(parameters), *_summary_lines(summary), *_link_lines(parameters)]))


def _as_json(file: Path, parameters: "Parameters", summary: "Summary") -> dict[str, Any]:
    from swingd.config.plain import plain
    from swingd.config.schema import KEYS, value_of

    return {
        "file": str(file),
        "parameters": plain(parameters),
        "changed": [key.name for key in KEYS.values() if value_of(parameters, key.name) != key.default],
        "swing": {"fixed_pivot": _oscillation(summary.swing_fixed), "free_vehicle": _oscillation(summary.swing_free)},
        "hover": {
            "thrust_n": summary.hover_thrust_n,
            "nominal": {"voltage_v": summary.hover_nominal.voltage_v, "throttle": summary.hover_nominal.throttle},
            "sagged": {"voltage_v": summary.hover_sagged.voltage_v, "throttle": summary.hover_sagged.throttle},
        },
        "correction": _correction(summary.correction),
        "links": _links(parameters),
    }


def _links(parameters: "Parameters") -> dict[str, str]:
    """Give every link by its key, with the host that an empty one stands for."""
    from swingd.link.url import LOOPBACK, parse_url

    endpoints = enumerate(parameters.endpoints, 1)
    return {
        "link.autopilot": str(parse_url(parameters.link.autopilot)),
        **{f"endpoints.{place}.url": str(parse_url(endpoint.url, LOOPBACK)) for place, endpoint in endpoints},
    }


def _correction(correction: "Correction") -> dict[str, Any]:
    return {
        "law": correction.law,
        "kp_mps2_per_rad": correction.kp_mps2_per_rad,
        "kd_mps2_per_radps": correction.kd_mps2_per_radps,
        "off": {**_oscillation(correction.off), "damping_ratio": correction.damping_ratio_off},
        "on": correction.on and {**_oscillation(correction.on), "damping_ratio": correction.damping_ratio_on},
        "poles_per_s": [[pole.real, pole.imag] for pole in correction.poles_per_s],
    }


def _oscillation(swing: "Oscillation") -> dict[str, float]:
    return {
        "frequency_radps": swing.frequency_radps,
        "frequency_hz": swing.frequency_hz,
        "period_s": swing.period_s,
    }


def _parameter_lines(parameters: "Parameters") -> list[str]:
    from swingd.config.schema import ITEM_KEYS, KEYS, ROOT, Group

    width = max(len(key.path[-1]) for key in (*KEYS.values(), *ITEM_KEYS)) + 2
    lines: list[str] = []
    for name, member in ROOT.members.items():
        value = getattr(parameters, name)
        if isinstance(member, Group):
            lines += ["", name, *_group_lines(member, value, width)]
        elif member.item is None:
            lines.append(_key_line(member, value, width))
        else:
            lines += [] if value else ["", name, "  none"]
            for place, item in enumerate(value, 1):
                lines += ["", f"{name}.{place}", *_group_lines(member.item, item, width)]
    return lines


def _group_lines(group: "Group", value: Any, width: int) -> list[str]:
    return [_key_line(key, getattr(value, key.path[-1]), width) for key in group.every_key()]


def _key_line(key: "Key", value: Any, width: int) -> str:
    from swingd.config.render import yaml_text

    changed = value != key.default
    text = f"{yaml_text(value)} {key.unit}".rstrip()
    default = f"  (default {yaml_text(key.default)})" if changed else ""
    return f"{'*' if changed else ' '} {key.path[-1]:<{width}}{text}{default}"


def _summary_lines(summary: "Summary") -> list[str]:
    return [
        "",
        "linear swing",
        _swing_line("fixed pivot", summary.swing_fixed),
        _swing_line("free vehicle", summary.swing_free),
        "",
        f"hover with the load, {summary.hover_thrust_n:.2f} N",
        _hover_line(summary.hover_nominal),
        _hover_line(summary.hover_sagged),
        "",
        *_correction_lines(summary.correction),
    ]


def _correction_lines(correction: "Correction") -> list[str]:
    lines = [
        f"correction, law {correction.law}",
        f"  {'gains':<14}{correction.kp_mps2_per_rad:.3f} m/s^2/rad  {correction.kd_mps2_per_radps:.3f} m/s^2/(rad/s)",
        f"{_swing_line('without', correction.off)}  damping ratio {correction.damping_ratio_off:.3f}",
    ]
    if correction.on is None:
        return [*lines, f"  {'with':<14}not computed: this law's gains are given, not designed"]
    return [*lines, f"{_swing_line('with', correction.on)}  damping ratio {correction.damping_ratio_on:.3f}"]


def _link_lines(parameters: "Parameters") -> list[str]:
    return ["", "links", *(f"  {name:<18}{url}" for name, url in _links(parameters).items())]


def _swing_line(name: str, swing: "Oscillation") -> str:
    return f"  {name:<14}{swing.frequency_radps:.3f} rad/s  {swing.frequency_hz:.3f} Hz  period {swing.period_s:.2f} s"


def _hover_line(point: "HoverPoint") -> str:
    throttle = "not possible" if point.throttle is None else f"{point.throttle:.1%} throttle"
    return f"  {f'at {point.voltage_v:.2f} V':<14}{throttle}"
