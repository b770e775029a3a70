"""Docstrings as they stand in the source: plain text, names in columns, code between backticks; no markup to learn."""

from __future__ import annotations

import re
from collections.abc import Iterator
from itertools import groupby
from typing import Any

from sphinx.application import Sphinx

COLUMN = re.compile(r"^(\s*)(\S+(?: \S+)*?) {2,}(\S.*)$")
"""A name and, two blanks or more to the right, what it is."""

NOT_CALLED = (".Recording", ".Result", ".Plan", ".Heard", ".FrameState", ".Config")
"""Classes whose objects nuno makes."""


def _text(line: str) -> str:
    """As reStructuredText: code is code, and nothing else is markup."""
    parts = re.split(r"`([^`]+)`", line)
    parts[::2] = (re.sub(r"([\\*|`]|_(?!\w))", r"\\\1", part) for part in parts[::2])
    parts[1::2] = (f"``{part}``" for part in parts[1::2])
    # An empty comment parts code from a letter that touches it.
    return "\\ ".join(part for part in parts if part) if len(parts) > 1 else parts[0]


def _paragraph(lines: list[str]) -> Iterator[str]:
    """A paragraph's lines: names in columns become definitions, what is indented stays as it is."""
    if all(line.startswith("    ") for line in lines) and not any(map(COLUMN.match, lines)):
        yield from ["::", "", *lines]
        return
    named = False
    for line in lines:
        if found := COLUMN.match(line):
            yield from ["", _text(found[2]), f"    {_text(found[3])}"]
            named = True
        elif named and line.startswith("  "):
            yield f"    {_text(line.strip())}"
        else:
            yield from ["", _text(line)] if named else [_text(line.strip())]
            named = False


def _process(app: Sphinx, what: str, name: str, found: Any, options: Any, lines: list[str]) -> None:
    """Sphinx's event autodoc-process-docstring: changes the lines in place."""
    groups = [list(group) for filled, group in groupby(lines, key=lambda line: bool(line.strip())) if filled]
    lines[:] = [line for group in groups for line in (*_paragraph(group), "")]


def _sign(app: Sphinx, what: str, name: str, found: Any, options: Any, given: str, returned: str) -> Any:
    """Sphinx's event autodoc-process-signature: what is not made by calling it has no arguments; types are plain."""
    uncalled = what == "class" and (getattr(found, "_is_protocol", False) or name.endswith(NOT_CALLED))
    return ("", "") if uncalled else (given and _type(given), returned and _type(returned))


def _type(text: str) -> str:
    """Types as the source writes them, without the sizes and bounds of arrays, which the docstring tells."""
    text = re.sub(r"TypeAliasForwardRef\('(\w+)'\)", r"\1", text)
    text = re.sub(
        r"~?numpy\.ndarray\[tuple\[~?typing\.Any, \.\.\.\], ~?numpy\.dtype\[~?numpy\.(\w+)\]\]", r"NDArray[\1]", text
    )
    while found := re.search(r"~?(?:\w+\.)*Annotated\[", text):
        depth, comma, end = 1, None, found.end()
        while depth:
            sign, end = text[end], end + 1
            depth += {"[": 1, "(": 1, "]": -1, ")": -1}.get(sign, 0)
            comma = end - 1 if sign == "," and depth == 1 and comma is None else comma
        text = text[: found.start()] + text[found.end() : comma] + text[end:]
    return text


def setup(app: Sphinx) -> dict[str, bool]:
    """Called by Sphinx."""
    app.connect("autodoc-process-docstring", _process)
    app.connect("autodoc-process-signature", _sign)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
