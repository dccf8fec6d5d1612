"""Brings what is derived from the parameters' declarations up to date: configs/, its schema, docs/configuration.md.

A file of configs/ owns its values, its head comment and the comments behind values; the line above each key is derived.
So edit a value in place, then run this.
"""

import argparse
import difflib
import json
import re
import sys
from collections.abc import Sequence
from pathlib import Path

import yaml

from swingd.config.loader import load_parameters
from swingd.config.render import dump_parameters, markdown_tables, yaml_text
from swingd.config.schema import GROUPS, KEYS, json_schema

ROOT = Path(__file__).resolve().parent.parent

REFERENCE = """\
# Configuration

A configuration is one YAML file. Every key has a default, so a file needs only what differs; the files in `configs/`
show every key. Units are SI and radians, and the end of a key's name says which.

    swingd check configs/x500.yaml
    swingd check configs/x500.yaml --set payload.mass_kg=0.4 --set 'hold.vel_ned_mps=[1, 0, 0]'

`swingd check` prints the resolved values and what follows from them. Every command that takes `-c FILE` takes
`--set KEY=VALUE`, repeated as often as needed: dotted key, value in YAML, the last one of a key counts. A file with
mistakes is refused as a whole, with all of them listed: key, line, value, and what was expected (exit code 78). Values
that are each allowed but do not go together, such as a thrust curve that cannot carry the load, are refused too.

What an application or a ground station connects to is a list, and what is wrong with its second item is told of
`endpoints.2.url`, `endpoints.2.shaper` and so on:

    endpoints:
      - url: udpin://127.0.0.1:14541
        shaper: zv
      - url: tcpin://0.0.0.0:5760
        key_file: /etc/swingd/gcs.key
        system_ids: [255]

An endpoint whose URL leaves the host empty waits on this machine alone (127.0.0.1); the link to the autopilot, on every
IPv4 address (0.0.0.0). `--set` takes the whole list, `--set 'endpoints=[{url: "udpin://:14541", shaper: zv}]'`, or one
value in it, `--set endpoints.1.shaper=zvd`; the place behind the last one makes a new endpoint.

Numbers are plain decimals or powers of ten (`1e-3`), never quoted; `true` and `false` are switches. An editor with a
YAML language server completes and checks keys with `configs/schema.json`, which `swingd schema` prints as well.

The tables below come from the declarations in `swingd/model/parameters.py`. What has a name in the column *parameter*
can be changed by a ground station while swingd runs.

"""


def head_and_notes(text: str) -> tuple[str, dict[str, str]]:
    """Give the comment at the top of a YAML file and the comments behind its values, by dotted key."""
    lines = text.splitlines()
    top = next((index for index, line in enumerate(lines) if not line.startswith("#")), len(lines))
    head = "\n".join(line.removeprefix("#").removeprefix(" ") for line in lines[:top])
    notes: dict[str, str] = {}

    def collect(node: yaml.Node, path: tuple[str, ...]) -> None:
        if isinstance(node, yaml.MappingNode):
            for key, value in node.value:
                collect(value, (*path, key.value))
        elif isinstance(node, yaml.SequenceNode) and any(isinstance(item, yaml.MappingNode) for item in node.value):
            for place, item in enumerate(node.value, 1):
                collect(item, (*path, str(place)))
        elif path and node.end_mark.line < len(lines):
            rest = lines[node.end_mark.line][node.end_mark.column :]
            if match := re.match(r"\s*#\s*(.+)", rest):
                notes[".".join(path)] = match[1].strip()

    if (root := yaml.compose(text, yaml.SafeLoader)) is not None:
        collect(root, ())
    return head, notes


def derived(root: Path, reset: Sequence[str] = ()) -> dict[Path, str]:
    """Give every derived file below ``root`` with the text that it should have.

    Keys that are named in ``reset``, or whose group is, return to their defaults in every file of configs/.
    """
    overrides = [
        f"{key.name}={yaml_text(key.default)}" for key in KEYS.values() if key.name in reset or key.path[0] in reset
    ]
    files = {
        root / "docs" / "configuration.md": REFERENCE + markdown_tables(),
        root / "configs" / "schema.json": json.dumps(json_schema(), indent=1) + "\n",
    }
    for path in sorted((root / "configs").glob("*.yaml")):
        files[path] = dump_parameters(
            load_parameters(path, overrides), *head_and_notes(path.read_text(encoding="utf-8"))
        )
    return files


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--check", action="store_true", help="write nothing; print the differences and exit with 1")
    parser.add_argument("--root", type=Path, default=ROOT, help="the project's folder (default: this one)")
    parser.add_argument(
        "--reset",
        action="append",
        default=[],
        choices=[*KEYS, *GROUPS],
        metavar="KEY",
        help="return a key, or every key of a group, to its default in all files of configs/; repeatable",
    )
    args = parser.parse_args()
    stale = False
    for path, text in derived(args.root, args.reset).items():
        old = path.read_text(encoding="utf-8") if path.exists() else ""
        if old == text:
            continue
        stale = True
        name = str(path.relative_to(args.root))
        if args.check:
            diff = difflib.unified_diff(old.splitlines(), text.splitlines(), name, f"{name} as declared", lineterm="")
            print("\n".join(diff))
        else:
            path.parent.mkdir(exist_ok=True)
            path.write_text(text, encoding="utf-8")
            print(f"wrote {name}")
    if stale and args.check:
        print("run: python tools/configs.py", file=sys.stderr)
    return int(stale and args.check)


if __name__ == "__main__":
    sys.exit(main())
