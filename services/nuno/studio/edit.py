"""Changing one value of a scene's text, so that all else in it stays as it was written: comments, order, spacing.

As where lines are added (nuno.draw.append), the text is left alone but for the value's own place, and the result is
read again: unless it gives what was there with that one change, it is refused.
"""

from __future__ import annotations

import contextlib
import re
from collections.abc import Iterator
from copy import deepcopy
from typing import Any

import yaml

from nuno.draw.append import end_of, flow, last_mark
from nuno.scene import yaml_lines
from nuno.scene.yaml_lines import Path, dotted
from nuno_schemas.errors import BadInput

REMEDY = "change it in the text itself"


def put(text: str, path: Path, value: Any, file: str, written: str | None = None) -> str:
    """The text with a value at a path, whose last part may be new: a field, or one item more of a list.

    `written` is how the value is to be written, where it is YAML for just that. Raises BadInput.
    """
    before, _ = yaml_lines.parse(text, file)
    expected = _with(before, path, value)
    for shown in (written, flow(value)):
        if shown:
            after = _put(text, path, shown.strip())
            with contextlib.suppress(BadInput):
                if yaml_lines.parse(after, file)[0] == expected:
                    return after
    raise BadInput("this cannot be written into the text and all else left as it is", file, None, dotted(path),
                   remedy=REMEDY)  # fmt: skip


def drop(text: str, path: Path, file: str) -> str:
    """The text without what is at a path. Raises BadInput."""
    before, _ = yaml_lines.parse(text, file)
    expected = deepcopy(before)
    inside: Any = expected
    try:
        for part in path[:-1]:
            inside = inside[part]
        del inside[path[-1]]
    except (KeyError, IndexError, TypeError):
        raise BadInput("this is not in the text", file, None, dotted(path), remedy="load the page again") from None
    with contextlib.suppress(BadInput):
        for after in _dropped(text, path):
            if yaml_lines.parse(after, file)[0] == expected:
                return after
    raise BadInput("this cannot be taken out of the text and all else left as it is", file, None, dotted(path),
                   remedy=REMEDY)  # fmt: skip


def _with(data: dict[str, Any], path: Path, value: Any) -> dict[str, Any]:
    """A copy of the data with a value at a path. Raises BadInput where that leads nowhere."""
    found: dict[str, Any] = deepcopy(data)
    inside: Any = found
    for i, part in enumerate(path):
        last = i == len(path) - 1
        below = value if last else [] if isinstance(path[i + 1], int) else {}
        if isinstance(inside, dict) and isinstance(part, str):
            inside[part] = below if last or inside.get(part) is None else inside[part]
        elif isinstance(inside, list) and isinstance(part, int) and 0 <= part <= len(inside):
            inside[part : part + 1] = [below if last or part == len(inside) else inside[part]]
        else:
            raise BadInput("there is no such place in the scene", field=dotted(path), remedy=REMEDY)
        inside = inside[part]
    return found


def _root(text: str) -> yaml.Node:
    node = yaml.compose(text, Loader=yaml.SafeLoader)
    assert node is not None
    return node


def _child(node: yaml.Node, part: str | int) -> yaml.Node | None:
    if isinstance(node, yaml.MappingNode):
        return next((value for key, value in node.value if key.value == part), None)
    if isinstance(node, yaml.SequenceNode) and isinstance(part, int):
        return next(iter(node.value[part : part + 1]), None)
    return None


def _put(text: str, path: Path, shown: str) -> str:
    node = _root(text)
    for depth, part in enumerate(path):
        child = _child(node, part)
        if child is None or _says_nothing(child):
            rest = path[depth + 1 :]
            block = isinstance(node, yaml.MappingNode) and not node.flow_style
            if rest == (0,) and block:  # a list that begins, as scenes have theirs
                return _add(text, node, part, f"\n{' ' * (_column(node) + 2)}- {shown}", child)
            return _add(text, node, part, _nested(rest, shown), child)
        node = child
    return _replace(text, node, shown)


def _column(node: yaml.Node) -> int:
    """Where the names of a block's fields begin, or the dashes of its items."""
    first = node.value[0]
    return int((first[0] if isinstance(first, tuple) else node).start_mark.column)


def _says_nothing(node: yaml.Node) -> bool:
    """Whether a field is there without a value."""
    return isinstance(node, yaml.ScalarNode) and node.style is None and not node.value


def _nested(path: Path, shown: str) -> str:
    for part in reversed(path):
        shown = f"[{shown}]" if isinstance(part, int) else f"{{{flow(part)}: {shown}}}"
    return shown


def _replace(text: str, node: yaml.Node, shown: str) -> str:
    start, end = node.start_mark.index, last_mark(text, node)
    if isinstance(node, yaml.CollectionNode) and not node.flow_style:
        named = NAMED.search(text, 0, start)
        if named is None:  # behind a dash
            return f"{text[:start].rstrip()} {shown}{text[len(text[: end_of(text, node)].rstrip(chr(10))) :]}"
        # It stands on lines of its own, below its name, and comments between the two are about it.
        end = _own_end(text, node, max(_column(node), len(named["before"]) + 1))
        return f"{text[: named.end('name')]} {shown}{named['comment']}\n{text[end:]}"
    return text[:start] + shown + text[end:]


NAMED = re.compile(r"(?m)^(?P<name>(?P<before>[ -]*)[^\s#-].*?:)(?P<comment>[ ]*(?: #.*)?)\n(?:[ ]*(?:#.*)?\n)*[ ]*\Z")
"""The line of a name whose value begins on a later one, until there."""


def _own_end(text: str, node: yaml.Node, column: int) -> int:
    """Where the last line of a block ends, with the comments below it that stand as far in as what it holds."""
    end, comment = end_of(text, node), re.compile(f" {{{column},}}#.*(?:\n|$)")
    while found := comment.match(text, end):
        end = found.end()
    return end


def _add(text: str, node: yaml.Node, part: str | int, shown: str, there: yaml.Node | None) -> str:
    """One field or item more of a collection; or the value of a field that is `there` without one."""
    assert isinstance(node, yaml.CollectionNode)
    if there is not None:
        key = next(key for key, value in node.value if value is there)
        at = text.index(":", key.end_mark.index) + 1
        return f"{text[:at]}{_behind(shown)}{text[at:]}"
    shown = shown if isinstance(part, int) else f"{flow(part)}:{_behind(shown)}"
    if node.flow_style:
        if not node.value:
            at = node.start_mark.index + 1
            return text[:at] + shown + text[at:]
        last = node.value[-1]
        at = last_mark(text, last[1] if isinstance(last, tuple) else last)
        return f"{text[:at]}, {shown}{text[at:]}"
    column, at = _column(node), end_of(text, node)
    newline = "" if text[:at].endswith("\n") else "\n"
    return f"{text[:at]}{newline}{' ' * column}{'- ' if isinstance(part, int) else ''}{shown}\n{text[at:]}"


def _behind(shown: str) -> str:
    """What follows a colon."""
    return shown if shown.startswith("\n") else f" {shown}"


def _dropped(text: str, path: Path) -> Iterator[str]:
    """Texts without what is at a path, of which the first that says so is the one."""
    node = _root(text)
    for part in path[:-1]:
        child = _child(node, part)
        assert child is not None
        node = child
    assert isinstance(node, yaml.CollectionNode)
    # Where each entry begins, and what it holds.
    spans = [(one[0], one[1]) if isinstance(one, tuple) else (one, one) for one in node.value]
    last = path[-1]
    number = last if isinstance(last, int) else [key.value for key, _ in spans].index(last)
    key, value = spans[number]
    if len(spans) == 1:
        yield _replace(text, node, "{}" if isinstance(node, yaml.MappingNode) else "[]")
    elif node.flow_style:
        if number:
            yield text[: last_mark(text, spans[number - 1][1])] + text[last_mark(text, value) :]
        else:
            yield text[: key.start_mark.index] + text[spans[1][0].start_mark.index :]
    else:
        begin = text.rfind("\n", 0, key.start_mark.index) + 1
        if text[begin : key.start_mark.index].strip(" ") == ("-" if isinstance(last, int) else ""):
            inside = key.start_mark.column + (0 if isinstance(last, int) else 1)
            yield text[:begin] + text[_own_end(text, value, inside) :]
        elif number + 1 < len(spans):  # the first field, behind a dash
            after = spans[number + 1][0].start_mark.index
            if "#" not in text[last_mark(text, value) : after]:
                yield text[: key.start_mark.index] + text[after:]
