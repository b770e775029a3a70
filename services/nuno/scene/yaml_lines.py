"""Safe reading of YAML: no tags that change a value, bounded size, depth and aliases; and the line of every field."""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterator
from typing import Any

import yaml

from nuno_schemas.errors import BadInput
from nuno_schemas.units import decimal_point
from nuno_schemas.written import Path as Path
from nuno_schemas.written import dotted as dotted

MAX_BYTES = 4_000_000
MAX_NODES = 200_000
MAX_DEPTH = 40
LIBYAML_TOO_DEEP = "exceeded maximum nesting depth"
"""Error of a libyaml that counts brackets itself, raised before any event, since it reads far ahead."""
START = "write `name: value` lines; for a scene, start from a shipped one: nuno scenes --paths"
_Loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
"""libyaml's loader, 20 times faster and in linear time, where PyYAML was built with it."""
_TRAP = re.compile(r"[-+]?(?:0[0-7_]*[1-7][0-7_]+|[0-9][0-9_]*(?::[0-5]?[0-9])+(?:\.[0-9_]*)?)")
"""Numbers that YAML 1.1 reads in base 8 or 60."""
_CUT = re.compile(r"[-+]?\d+,\d+(?![\d.]).*")
_SCALARS = {f"tag:yaml.org,2002:{name}" for name in ("null", "bool", "int", "float", "str")}


class _Reader:
    def __init__(self, file: str) -> None:
        self.file = file
        self.lines: dict[Path, int] = {}
        self.empty: list[Path] = []
        self.nodes = 0
        self.scalars = yaml.constructor.SafeConstructor()
        self.tags = yaml.resolver.Resolver()

    def read(self, node: yaml.Node, path: Path) -> Any:
        self.nodes += 1
        line = node.start_mark.line + 1
        # Aliases are expanded here, so a short text that stands for a huge tree is refused
        # while it is counted, before it is built.
        if self.nodes > MAX_NODES or len(path) > MAX_DEPTH:
            problem, limit = "the file is too large or nests too deep", f"{MAX_NODES} nodes, {MAX_DEPTH} levels"
            remedy = "remove nested aliases; put arrays into .npz files"
            raise BadInput(problem, self.file, line, limit=limit, remedy=remedy)
        self.lines.setdefault(path, line)
        if node.tag == self._own_tag(node):
            if isinstance(node, yaml.MappingNode):
                return self._mapping(node, path)
            if isinstance(node, yaml.SequenceNode):
                self._check_commas(node.value, path)
                return [self.read(child, (*path, i)) for i, child in enumerate(node.value)]
            if isinstance(node, yaml.ScalarNode) and node.tag in _SCALARS:
                return self._scalar(node, path)
            if node.tag == "tag:yaml.org,2002:timestamp":
                return node.value
        raise self._at(node, path, "YAML tags are not allowed", node.tag, "remove the tag")

    def _at(self, node: yaml.Node, path: Path, problem: str, value: object, remedy: str) -> BadInput:
        return BadInput(problem, self.file, node.start_mark.line + 1, dotted(path), value, remedy=remedy)

    def _own_tag(self, node: yaml.Node) -> str:
        """Return the tag of a node without an explicit one."""
        plain = not getattr(node, "style", None)
        tag: str = self.tags.resolve(type(node), node.value, (plain, True))  # type: ignore[no-untyped-call]
        return tag

    def _scalar(self, node: yaml.ScalarNode, path: Path) -> Any:
        if not node.value and not node.style:
            self.empty.append(path)
        try:
            value = self.scalars.construct_object(node)
            if not node.style and isinstance(value, int | float) and _TRAP.fullmatch(node.value):
                raise self._other_base(node, path, value)
            return value
        except ValueError:  # for example an integer of more digits than Python converts
            raise self._at(node, path, "not a number that can be read", node.value, "write fewer digits") from None

    def _other_base(self, node: yaml.ScalarNode, path: Path, value: float) -> BadInput:
        base, decimal = (60, "") if ":" in node.value else (8, f", or {int(node.value.replace('_', ''))}")
        remedy = f"write {value}{decimal}, or '{node.value}' in quotes where text is meant"
        return self._at(node, path, f"YAML reads this as a number of base {base}: {value}", node.value, remedy)

    def _check_commas(self, items: list[yaml.Node], path: Path) -> None:
        """Raise BadInput for a list such as [0,3, 1]: blanks after some of its commas make others decimal ones."""
        numbers = all(isinstance(item, yaml.ScalarNode) and "." not in item.value for item in items)
        if numbers and any(_gap(*pair) > 1 for pair in itertools.pairwise(items)):
            for one, other in itertools.pairwise(items):
                self._check_comma(one, other, path, f", or {one.value}, {other.value} for two numbers")

    def _check_comma(self, one: yaml.Node, other: yaml.Node, path: Path, more: str = "") -> None:
        """Raise BadInput where two neighbours may be one number: plain digits on both sides of a comma, no blank."""
        plain = all(isinstance(node, yaml.ScalarNode) and not node.style for node in (one, other))
        if plain and _gap(one, other) == 1 and _CUT.fullmatch(value := f"{one.value},{other.value}"):
            raise self._at(one, path, "a decimal comma", value, f"{decimal_point(value)}{more}")

    def _mapping(self, node: yaml.MappingNode, path: Path) -> dict[str, Any]:
        result: dict[str, Any] = {}
        for (name, one), (other, child) in itertools.pairwise(node.value):
            # In braces, 0,3 is a 0, and an empty field with the name 3.
            if child.value == "" and not child.style:
                self._check_comma(one, other, (*path, str(name.value)))
        for key_node, child in node.value:
            if not isinstance(key_node, yaml.ScalarNode):
                raise self._at(key_node, path, "a field name must be plain text", None, "write name: value")
            if key_node.tag == "tag:yaml.org,2002:merge":
                remedy = "write its fields here; an alias may stand for a whole value: model: *name"
                raise self._at(key_node, path, "merge keys of YAML are not supported", key_node.value, remedy)
            if key_node.tag != self._own_tag(key_node):
                raise self._at(key_node, path, "YAML tags are not allowed", key_node.tag, "remove the tag")
            key = str(key_node.value)
            if key in result:
                raise self._at(key_node, (*path, key), "the field is given twice", None, "keep one of them")
            self.lines[(*path, key)] = key_node.start_mark.line + 1
            result[key] = self.read(child, (*path, key))
        return result


def _gap(one: yaml.Node, other: yaml.Node) -> int:
    """Return the number of characters between two neighbours on a line; 0 where a new line begins."""
    return other.start_mark.column - one.end_mark.column if one.end_mark.line == other.start_mark.line else 0


def walk(value: Any, path: Path = ()) -> Iterator[tuple[Path, Any]]:
    """Yield a value and all values in it, each with its path."""
    yield path, value
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list | tuple) else ()
    for key, item in items:
        yield from walk(item, (*path, key))


def parse(text: str, file: str) -> tuple[dict[str, Any], dict[Path, int]]:
    """Parse a YAML text; return its mapping, and the line of every path. Raises BadInput."""
    return parse_all(text, file)[:2]


def parse_all(text: str, file: str) -> tuple[dict[str, Any], dict[Path, int], tuple[Path, ...]]:
    """Parse as `parse`, and return also the paths without a written value, not even `null`. Raises BadInput."""
    if len(text) > MAX_BYTES:
        raise too_large(file, len(text))
    node = _compose(text, file)
    reader = _Reader(file)
    if node is None:
        raise BadInput("the file is empty", file, remedy=START)
    if not isinstance(node, yaml.MappingNode):
        raise BadInput("the file is no mapping of fields", file, node.start_mark.line + 1, remedy=START)
    return reader.read(node, ()), reader.lines, tuple(reader.empty)


def too_large(file: str, size: int) -> BadInput:
    remedy = "put arrays into .npz files"
    return BadInput("the file is too large", file, None, None, f"{size} bytes", f"{MAX_BYTES} bytes", remedy)


def _compose(text: str, file: str) -> yaml.Node | None:
    """Return the text's tree of nodes, None for an empty text. Raises BadInput."""
    strange = yaml.reader.Reader.NON_PRINTABLE.search(text)
    if strange is not None:
        line = text.count("\n", 0, strange.start()) + 1
        problem = f"not valid YAML: the character U+{ord(strange.group()):04X} is not allowed"
        raise BadInput(problem, file, line, remedy="remove it; was the file saved as plain text?")
    try:
        _require_shallow(text, file)
        return yaml.compose(text, Loader=_Loader)
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        place, problem = mark.line + 1 if mark else None, str(getattr(error, "problem", error))
        if problem == LIBYAML_TOO_DEEP:
            raise _too_deep(file, place) from None
        remedy = "check indentation, colons and brackets on that line"
        raise BadInput(f"not valid YAML: {problem}", file, place, remedy=remedy) from None


def _too_deep(file: str, line: int | None) -> BadInput:
    remedy = "remove brackets and indentation"
    return BadInput("the file nests too deep", file, line, limit=f"{MAX_DEPTH} levels", remedy=remedy)


def _require_shallow(text: str, file: str) -> None:
    """Raise BadInput where the text nests too deep: libyaml makes nodes by recursion, until the stack overflows."""
    depth = 0
    for event in yaml.parse(text, Loader=_Loader):
        depth += isinstance(event, yaml.CollectionStartEvent) - isinstance(event, yaml.CollectionEndEvent)
        if depth > MAX_DEPTH:
            raise _too_deep(file, event.start_mark.line + 1 if event.start_mark else None)


def parse_value(text: str) -> Any:
    """Parse the value of a YAML text; a colour #rgb, alone or in a list, is no comment. Raises BadInput."""
    if text.startswith("#"):
        return text
    if text.startswith(("[", "{")) and not {"'", '"'} & set(text):
        text = re.sub(r"(?<=[\[,\s])#[0-9A-Fa-f]{3,8}(?=[\],}\s])", r"'\g<0>'", text)
    try:
        node = _compose(text, "")
    except BadInput:
        remedy = "quote it, or write a number, [a, b, c] or {key: value}"
        raise BadInput("not a valid value", remedy=remedy) from None
    return None if node is None else _Reader("").read(node, ())
