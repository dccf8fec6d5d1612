"""Reads YAML into a draft: a safe subset, with the line of every key."""

import re
from dataclasses import dataclass
from typing import Any

import yaml

from swingd.config.draft import Draft, Place, printable, shown
from swingd.config.schema import LIST_MAX, Group, find
from swingd.config.source import Source
from swingd.model.errors import ConfigurationError

DEPTH_MAX = 16
"""Deepest nesting that is read; a configuration needs five levels."""


class Loader(yaml.SafeLoader):
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
Loader.yaml_implicit_resolvers = {
    first: [(tag, pattern) for tag, pattern in resolvers if tag in _KEPT_TAGS]
    for first, resolvers in yaml.SafeLoader.yaml_implicit_resolvers.items()
}
Loader.add_implicit_resolver("tag:yaml.org,2002:int", re.compile(r"^[-+]?(?:0|[1-9][0-9]*)$"), list("-+0123456789"))
Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float",
    re.compile(
        r"^(?:[-+]?(?:\.[0-9]+|[0-9]+(?:\.[0-9]*)?)(?:[eE][-+]?[0-9]+)?|[-+]?\.(?:inf|Inf|INF)|\.(?:nan|NaN|NAN))$"
    ),
    list("-+.0123456789"),
)


def read_document(source: Source) -> Draft:
    """Read a configuration file.

    Returns
    -------
    Draft
        What the file says, with the line of each key; its problems so far are keys given twice and a file that is not a
        mapping.

    Raises
    ------
    ConfigurationError
        If the content is not UTF-8, or not YAML.
    """
    try:
        text = source.content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = source.content.count(b"\n", 0, error.start) + 1
        raise ConfigurationError(
            f"{source.name}: line {line}: byte 0x{source.content[error.start]:02x} is not UTF-8; expected YAML in UTF-8"
        ) from None
    try:
        return _read_document(text)
    except (yaml.YAMLError, ValueError) as error:
        raise ConfigurationError(f"{source.name}: {yaml_problem(error)}") from None


def read_value(draft: Draft, path: tuple[str, ...], text: str, option: str) -> Any:
    """Read the value of one key from an option, and note in the draft that it was given there.

    Raises
    ------
    yaml.YAMLError, ValueError
        If the text is not YAML; `yaml_problem` puts either in words.
    """
    loader = Loader(text)
    node = loader.get_single_node()
    name = ".".join(path)
    # What was said before about a list says nothing about the one that takes its place.
    draft.places = {key: place for key, place in draft.places.items() if not key.startswith(f"{name}.")}
    draft.places[name] = option
    return None if node is None else _Reader(draft, loader, option).value(node, path)


def yaml_problem(error: yaml.YAMLError | ValueError) -> str:
    """Put an error of the YAML parser on one line, with its place."""
    if not isinstance(error, yaml.MarkedYAMLError):
        return f"not YAML: {printable(' '.join(str(error).split()))}"
    mark = error.problem_mark or error.context_mark
    place = f"line {mark.line + 1}, column {mark.column + 1}: " if mark else ""
    return printable(f"{place}not YAML: {', '.join(text for text in (error.context, error.problem) if text)}")


@dataclass(frozen=True, slots=True)
class _Reader:
    """Constructs what the schema knows out of nodes, noting the place of each key and the keys given twice."""

    draft: Draft
    loader: Loader
    option: str = ""
    """Where the text was given; empty for a file, whose lines are the places."""

    def place(self, node: yaml.Node) -> Place:
        return self.option or node.start_mark.line + 1

    def group(self, node: yaml.MappingNode, path: tuple[str, ...]) -> dict[str, Any]:
        group: dict[str, Any] = {}
        for key_node, value_node in node.value:
            place = self.place(key_node)
            if not isinstance(key_node, yaml.ScalarNode):
                name = ".".join((*path, "?"))
                self.draft.refuse(name, "a list or mapping given; expected the name of a key", place)
                continue
            key = key_node.value
            name = ".".join((*path, key))
            if key in group:
                first = self.draft.places[name]
                first = f"on line {first}" if isinstance(first, int) else f"in {first}"
                self.draft.refuse(name, f"given again, first {first}; expected each key once", place)
            self.draft.places[name] = place
            group[key] = self.value(value_node, (*path, key))
        return group

    def value(self, node: yaml.Node, path: tuple[str, ...]) -> Any:
        declared = find(path)
        if declared is None:
            return None
        if isinstance(declared, Group):
            if isinstance(node, yaml.MappingNode):
                return self.group(node, path)
            # A group whose keys are all commented out reads as null.
            value = self.loader.construct_object(node, deep=True)
            return {} if value is None else value
        if declared.item is None:
            return self.loader.construct_object(node, deep=True)
        if isinstance(node, yaml.SequenceNode) and len(node.value) <= LIST_MAX:
            return [self.item(item, (*path, str(place))) for place, item in enumerate(node.value, 1)]
        value = self.loader.construct_object(node, deep=True)
        return [] if value is None else value

    def item(self, node: yaml.Node, path: tuple[str, ...]) -> Any:
        self.draft.places[".".join(path)] = self.place(node)
        if isinstance(node, yaml.MappingNode):
            return self.group(node, path)
        return self.loader.construct_object(node, deep=True)


def _read_document(text: str) -> Draft:
    draft = Draft()
    loader = Loader(text)
    root = loader.get_single_node()
    reader = _Reader(draft, loader)
    if isinstance(root, yaml.MappingNode):
        draft.values = reader.group(root, ())
    elif root is not None:
        value = loader.construct_object(root, deep=True)
        # A file of nothing but ``null`` says as little as an empty one.
        if value is not None:
            expected = "expected groups of keys, such as payload: {mass_kg: 0.3}"
            draft.refuse("the file", f"{shown(value)} given; {expected}", reader.place(root))
    return draft
