"""YAML read safely: no tags, bounded size, depth and aliases, and the line of every field."""

from __future__ import annotations

from typing import Any

import yaml

from nuno_schemas.errors import BadInput

MAX_BYTES = 4_000_000
MAX_NODES = 200_000
MAX_DEPTH = 40
_PLAIN = {f"tag:yaml.org,2002:{name}" for name in ("null", "bool", "int", "float", "str", "seq", "map")}

Path = tuple[str | int, ...]


class _Reader:
    def __init__(self, file: str) -> None:
        self.file = file
        self.lines: dict[Path, int] = {}
        self.nodes = 0
        self.scalars = yaml.constructor.SafeConstructor()

    def read(self, node: yaml.Node, path: Path) -> Any:
        self.nodes += 1
        line = node.start_mark.line + 1
        # Aliases are expanded here, so a short text that stands for a huge tree is refused
        # while it is counted, before it is built.
        if self.nodes > MAX_NODES or len(path) > MAX_DEPTH:
            raise BadInput(
                "the scene is too large or nests too deep",
                self.file,
                line,
                limit=f"{MAX_NODES} nodes, {MAX_DEPTH} levels",
                remedy="remove nested aliases; put arrays into .npz files",
            )
        self.lines.setdefault(path, line)
        if isinstance(node, yaml.MappingNode):
            return self._mapping(node, path)
        if isinstance(node, yaml.SequenceNode) and node.tag in _PLAIN:
            return [self.read(child, (*path, i)) for i, child in enumerate(node.value)]
        if isinstance(node, yaml.ScalarNode) and node.tag in _PLAIN:
            return self.scalars.construct_object(node)
        if node.tag == "tag:yaml.org,2002:timestamp":
            return node.value
        raise BadInput(
            "YAML tags are not allowed in scenes", self.file, line, dotted(path), node.tag, remedy="remove the tag"
        )

    def _mapping(self, node: yaml.MappingNode, path: Path) -> dict[str, Any]:
        if node.tag not in _PLAIN:
            raise BadInput(
                "YAML tags are not allowed in scenes",
                self.file,
                node.start_mark.line + 1,
                dotted(path),
                node.tag,
                remedy="remove the tag",
            )
        result: dict[str, Any] = {}
        for key_node, child in node.value:
            line = key_node.start_mark.line + 1
            if not isinstance(key_node, yaml.ScalarNode):
                raise BadInput("a field name must be plain text", self.file, line, dotted(path))
            key = str(key_node.value)
            if key in result:
                raise BadInput(
                    "the field is given twice", self.file, line, dotted((*path, key)), remedy="keep one of them"
                )
            self.lines[(*path, key)] = line
            result[key] = self.read(child, (*path, key))
        return result


def dotted(path: Path) -> str:
    """("objects", 0, "name") -> "objects[0].name"."""
    text = ""
    for part in path:
        text += f"[{part}]" if isinstance(part, int) else (f".{part}" if text else part)
    return text


def parse(text: str, file: str) -> tuple[dict[str, Any], dict[Path, int]]:
    """YAML text -> the mapping and the line of every path in it. Raises BadInput."""
    if len(text) > MAX_BYTES:
        raise BadInput(
            "the scene file is too large",
            file,
            value=f"{len(text)} characters",
            limit=f"{MAX_BYTES}",
            remedy="put arrays into .npz files",
        )
    try:
        node = yaml.compose(text, Loader=yaml.SafeLoader)
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        line = mark.line + 1 if mark else None
        raise BadInput(
            f"not valid YAML: {getattr(error, 'problem', error)}",
            file,
            line,
            remedy="check indentation, colons and brackets on that line",
        ) from None
    except RecursionError:
        raise BadInput("the scene nests too deep", file, limit=f"{MAX_DEPTH} levels") from None
    reader = _Reader(file)
    if not isinstance(node, yaml.MappingNode):
        raise BadInput("a scene is a mapping of fields", file, 1, remedy="start from a shipped one: nuno scenes")
    return reader.read(node, ()), reader.lines


def parse_value(text: str) -> Any:
    """The right side of --set key=value. Raises BadInput."""
    try:
        return _Reader("--set").read(
            yaml.compose(text, Loader=yaml.SafeLoader) or yaml.ScalarNode("tag:yaml.org,2002:null", ""), ()
        )
    except yaml.YAMLError:
        raise BadInput(
            "not a valid value", "--set", value=text, remedy="quote it, or write a number, [a, b, c] or {key: value}"
        ) from None
