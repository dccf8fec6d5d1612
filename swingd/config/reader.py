"""Reads YAML into a draft: a safe subset, with the line of every key."""

import re
from pathlib import Path
from typing import Any

import yaml

from swingd.config.draft import Draft, printable, shown
from swingd.config.schema import GROUPS, KEYS
from swingd.model.errors import ConfigurationError

SIZE_MAX = 256 * 1024
"""Largest file that is read [bytes]."""
DEPTH_MAX = 16
"""Deepest nesting that is read; a configuration needs three levels."""


class _Loader(yaml.SafeLoader):
    """Safe YAML whose numbers are those of YAML 1.2, which is what people and editors take them for.

    PyYAML follows YAML 1.1, where 1e-3 is a text, 010 is 8 and 1:30 is 90.
    """

    depth = 0

    def compose_node(self, parent: yaml.Node | None, index: int) -> yaml.Node | None:
        """Compose one node, within `DEPTH_MAX`."""
        if self.depth >= DEPTH_MAX:
            mark = self.peek_event().start_mark  # type: ignore[no-untyped-call]
            raise yaml.MarkedYAMLError(problem=f"nested deeper than {DEPTH_MAX} levels", problem_mark=mark)
        self.depth += 1
        try:
            return super().compose_node(parent, index)
        finally:
            self.depth -= 1


_KEPT_TAGS = ("tag:yaml.org,2002:null", "tag:yaml.org,2002:bool")
_Loader.yaml_implicit_resolvers = {
    first: [(tag, pattern) for tag, pattern in resolvers if tag in _KEPT_TAGS]
    for first, resolvers in yaml.SafeLoader.yaml_implicit_resolvers.items()
}
_Loader.add_implicit_resolver("tag:yaml.org,2002:int", re.compile(r"^[-+]?(?:0|[1-9][0-9]*)$"), list("-+0123456789"))
_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float",
    re.compile(
        r"^(?:[-+]?(?:\.[0-9]+|[0-9]+(?:\.[0-9]*)?)(?:[eE][-+]?[0-9]+)?|[-+]?\.(?:inf|Inf|INF)|\.(?:nan|NaN|NAN))$"
    ),
    list("-+.0123456789"),
)


def read_file(path: Path) -> Draft:
    """Read a configuration file.

    Returns
    -------
    Draft
        What the file says, with the line of each key; its problems so far are keys given twice and a file that is not a
        mapping.

    Raises
    ------
    ConfigurationError
        If the file cannot be read, is larger than `SIZE_MAX`, not UTF-8, or not YAML.
    """
    try:
        with path.open("rb") as file:
            content = file.read(SIZE_MAX + 1)
    except OSError as error:
        raise ConfigurationError(f"{path}: {error.strerror or error}; expected a configuration file in YAML") from None
    except ValueError as error:
        raise ConfigurationError(f"{shown(str(path))}: {error}; expected the path of a configuration file") from None
    if len(content) > SIZE_MAX:
        raise ConfigurationError(f"{path}: larger than {SIZE_MAX // 1024} KiB; expected a configuration file in YAML")
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = content.count(b"\n", 0, error.start) + 1
        raise ConfigurationError(
            f"{path}: line {line}: byte 0x{content[error.start]:02x} is not UTF-8; expected YAML in UTF-8"
        ) from None
    try:
        return _read_document(text)
    except (yaml.YAMLError, ValueError) as error:
        raise ConfigurationError(f"{path}: {yaml_problem(error)}") from None


def read_value(text: str) -> Any:
    """Read one value in YAML.

    Raises
    ------
    yaml.YAMLError, ValueError
        If the text is not YAML; `yaml_problem` puts either in words.
    """
    return yaml.load(text, _Loader)


def yaml_problem(error: yaml.YAMLError | ValueError) -> str:
    """Put an error of the YAML parser on one line, with its place."""
    if not isinstance(error, yaml.MarkedYAMLError):
        return f"not YAML: {printable(' '.join(str(error).split()))}"
    mark = error.problem_mark or error.context_mark
    place = f"line {mark.line + 1}, column {mark.column + 1}: " if mark else ""
    return printable(f"{place}not YAML: {', '.join(text for text in (error.context, error.problem) if text)}")


def _read_document(text: str) -> Draft:
    loader = _Loader(text)
    root = loader.get_single_node()
    draft = Draft()
    if isinstance(root, yaml.MappingNode):
        draft.values = _read_group(draft, loader, root, ())
    elif root is not None:
        value = loader.construct_object(root, deep=True)
        # A file of nothing but ``null`` says as little as an empty one.
        if value is not None:
            expected = "expected groups of keys, such as payload: {mass_kg: 0.3}"
            draft.refuse("the file", f"{shown(value)} given; {expected}", root.start_mark.line + 1)
    return draft


def _read_group(draft: Draft, loader: _Loader, node: yaml.MappingNode, path: tuple[str, ...]) -> dict[str, Any]:
    """Construct one group, noting the line of each key and the keys given twice."""
    group: dict[str, Any] = {}
    for key_node, value_node in node.value:
        line = key_node.start_mark.line + 1
        if not isinstance(key_node, yaml.ScalarNode):
            draft.refuse(".".join((*path, "?")), "a list or mapping given; expected the name of a key", line)
            continue
        key = key_node.value
        name = ".".join((*path, key))
        if key in group:
            draft.refuse(name, f"given again, first on line {draft.places[name]}; expected each key once", line)
        draft.places[name] = line
        if name in GROUPS and isinstance(value_node, yaml.MappingNode):
            group[key] = _read_group(draft, loader, value_node, (*path, key))
        elif name in GROUPS:
            # A group whose keys are all commented out reads as null.
            value = loader.construct_object(value_node, deep=True)
            group[key] = {} if value is None else value
        else:
            known = name in KEYS and KEYS[name].path == (*path, key)
            group[key] = loader.construct_object(value_node, deep=True) if known else None
    return group
