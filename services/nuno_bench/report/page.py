"""A report as values: tables, figures, pictures and facts, from which come its HTML page, its JSON and its CSV.

`page.html` beside this file is the one template. nuno_bench.report.markdown makes sections of the documentation from
the same values.
"""

from __future__ import annotations

import csv
import json
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, ClassVar

import jinja2
from markupsafe import Markup, escape

BAD = ("failed", "missed", "diverged", "contradicts")
GOOD = ("bar met", "aim met", "agrees")
"""Words that are coloured where a cell begins with them."""
LONG = 26
"""Cells with more characters than this wrap."""
MANY = 8
"""Tables with more columns than this are set smaller on paper."""


@dataclass(frozen=True)
class Table:
    """headings, rows of text, and a sentence above them."""

    kind: ClassVar[str] = "table"
    headings: Sequence[str]
    rows: Sequence[Sequence[str]]
    caption: str = ""
    prose: bool = False
    """Whether cells are sentences, which wrap."""

    @property
    def numeric(self) -> list[bool]:
        """Of each column whether it holds numbers alone, which stand to the right."""
        return [all(not row[c] or row[c][0] in "-+<>=.0123456789−≤≥" for row in self.rows)
                for c in range(len(self.headings))]  # fmt: skip

    @property
    def style(self) -> str | None:
        """Classes of the table in the page's style sheet."""
        return " ".join(["prose"] * self.prose + ["many"] * (len(self.headings) > MANY)) or None

    def look(self, cell: str, numeric: bool) -> str | None:
        """Classes of a cell in the page's style sheet."""
        names = ["number"] * numeric + ["long"] * (len(cell) > LONG)
        names += ["bad"] * _begins(cell, BAD) + ["good"] * _begins(cell, GOOD)
        return " ".join(names) or None

    def text(self) -> str:
        """Columns aligned for a screen, numbers to the right."""
        lines = [list(self.headings), *map(list, self.rows)]
        widths = [max(len(line[c]) for line in lines) for c in range(len(self.headings))]
        lines.insert(1, ["-" * width for width in widths])
        signs = [">" if right else "<" for right in self.numeric]
        padded = [[f"{cell:{s}{w}}" for cell, s, w in zip(line, signs, widths, strict=True)] for line in lines]
        return "\n".join("  ".join(line).rstrip() for line in padded)


@dataclass(frozen=True)
class Figure:
    """svg markup, and the sentence below it, which also describes it to those who do not see it.

    name tells it apart from other figures of a section of the documentation, where it becomes a file.
    """

    kind: ClassVar[str] = "figure"
    svg: str
    caption: str
    name: str = ""


@dataclass(frozen=True)
class Image:
    """A picture as a data URL, and the sentence below it."""

    source: str
    caption: str


@dataclass(frozen=True)
class Pictures:
    """Pictures side by side, as many in a row as fit."""

    kind: ClassVar[str] = "pictures"
    images: Sequence[Image]


@dataclass(frozen=True)
class Facts:
    """Names and values, e.g. the machine and the command."""

    kind: ClassVar[str] = "facts"
    values: Mapping[str, str]


Part = str | Table | Figure | Pictures | Facts
"""A paragraph of plain text, or one of the above."""
Sections = Sequence[tuple[str, Sequence[Part]]]
"""Headings ("" for none), each with its parts."""


def render(title: str, lead: str, sections: Sections) -> str:
    """The whole page."""
    return _template().render(title=title, lead=lead, sections=sections)


def write(base: Path, title: str, lead: str, sections: Sections, data: Mapping[str, Any], lines: Table) -> list[Path]:
    """Write the page, `data` as JSON and `lines` as CSV beside each other: `base` and an ending each."""
    base.parent.mkdir(parents=True, exist_ok=True)
    html, table, raw = (base.with_name(base.name + ending) for ending in (".html", ".csv", ".json"))
    html.write_text(render(title, lead, sections), encoding="utf-8")
    raw.write_text(json.dumps(_plain(data), indent=1) + "\n", encoding="utf-8")
    with table.open("w", newline="", encoding="utf-8") as stream:
        csv.writer(stream).writerows([lines.headings, *lines.rows])
    return [html, table, raw]


def _plain(value: Any) -> Any:
    """Arrays as lists; JSON has no infinity and no NaN, which are written as text."""
    if hasattr(value, "tolist"):
        value = value.tolist()
    if isinstance(value, Mapping):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    return str(value) if isinstance(value, float) and not math.isfinite(value) else value


@cache
def _template() -> jinja2.Template:
    loader = jinja2.FileSystemLoader(Path(__file__).parent)
    environment = jinja2.Environment(loader=loader, autoescape=True, trim_blocks=True, lstrip_blocks=True)
    environment.filters["text"] = _text
    return environment.get_template("page.html")


def _begins(text: str, words: Sequence[str]) -> bool:
    return any(text == word or text.startswith((word + " ", word + ",")) for word in words)


def _text(text: str) -> Markup:
    """Escaped; what stands between backticks is code."""
    return Markup(re.sub(r"`([^`]+)`", r"<code>\1</code>", str(escape(text))))
