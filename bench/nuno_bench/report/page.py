"""Reports of tables, figures, pictures and facts, written as HTML, JSON and CSV.

`page.html` next to this file is the only template. Sections of the documentation are made from the same values, and
only written by the command that measured them.
"""

from __future__ import annotations

import base64
import csv
import io
import json
import re
import statistics
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, ClassVar

import jinja2
from markupsafe import Markup, escape

from nuno.formatting import for_json
from nuno.output_files import replacing
from nuno_schemas.errors import BadInput, RunFailed

BAD = ("failed", "missed", "not reproduced", "diverged", "contradicts", "slower")
GOOD = ("reproduced", "bar met", "aim met", "agrees", "faster")
"""Words that colour a cell that begins with them."""
LONG = 26
"""Cells with more characters than this wrap."""
MANY = 8
"""Tables with more columns than this are set smaller on paper."""


@dataclass(frozen=True)
class Table:
    """A table: headings, rows of text, and a sentence above them."""

    kind: ClassVar[str] = "table"
    headings: Sequence[str]
    rows: Sequence[Sequence[str]]
    caption: str = ""
    prose: bool = False
    """Whether cells are sentences, which wrap."""

    @property
    def numeric(self) -> list[bool]:
        """Whether each column contains only numbers, and is aligned to the right."""
        return [all(not row[c] or row[c][0] in "-+<>=.0123456789−≤≥" for row in self.rows)
                for c in range(len(self.headings))]  # fmt: skip

    @property
    def style(self) -> str | None:
        """Classes of the table in the page's style sheet."""
        return " ".join(["prose"] * self.prose + ["many"] * (len(self.headings) > MANY)) or None

    def look(self, cell: str, numeric: bool) -> str | None:
        """Return the classes of a cell in the page's style sheet."""
        names = ["number"] * numeric + ["long"] * (len(cell) > LONG)
        names += ["bad"] * _begins(cell, BAD) + ["good"] * _begins(cell, GOOD)
        return " ".join(names) or None

    def text(self) -> str:
        """Return the table as text with aligned columns, numbers to the right."""
        lines = [list(self.headings), *map(list, self.rows)]
        widths = [max(len(line[c]) for line in lines) for c in range(len(self.headings))]
        lines.insert(1, ["-" * width for width in widths])
        signs = [">" if right else "<" for right in self.numeric]
        padded = [[f"{cell:{s}{w}}" for cell, s, w in zip(line, signs, widths, strict=True)] for line in lines]
        return "\n".join("  ".join(line).rstrip() for line in padded)

    def markdown(self) -> str:
        """Return the table as a Markdown pipe table."""
        lines = [self.headings, ["---"] * len(self.headings), *self.rows]
        return "\n".join("| " + " | ".join(cell.replace("|", "\\|") for cell in line) + " |" for line in lines)


@dataclass(frozen=True)
class Figure:
    """SVG markup, and the caption below it, which is also its text alternative.

    name distinguishes it from other figures of a section of the documentation, and is the name of its file there and
    when it is saved from a page.
    """

    kind: ClassVar[str] = "figure"
    svg: str
    caption: str
    name: str = ""

    @property
    def source(self) -> str:
        """The svg as a data URL."""
        return "data:image/svg+xml;base64," + base64.b64encode(self.svg.encode()).decode()


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
    """Return the page as HTML."""
    return _template().render(title=title, lead=lead, sections=sections)


@dataclass(frozen=True)
class Report:
    """The report of a measurement.

    sections  sections of the page; empty tables and sections are left out, `about` comes last
    about     circumstances of the measurement, by name
    data      all results, for JSON, to which `about` is added
    brief     parts for a section of the documentation, before `about`
    rows      lines of the CSV by column; missing columns are left empty
    """

    title: str
    lead: str
    sections: Sections
    about: Mapping[str, str]
    data: Mapping[str, Any]
    brief: Sequence[Part] = ()
    rows: Sequence[Mapping[str, Any]] = ()

    def page(self) -> str:
        """Return the page as HTML."""
        kept = [(heading, nonempty(parts)) for heading, parts in self.sections]
        sections = [(heading, parts) for heading, parts in kept if parts]
        return render(self.title, self.lead, [*sections, ("Made by", [Facts(self.about)])])

    def write(self, html: Path | None, data: Path | None, docs: Path | None, name: str) -> None:
        """Write the page, the data as JSON, and the section of this name of the page `docs`; print the paths."""
        if html is not None:
            _write_text(html, self.page())
        if data is not None:
            _write_text(data, json.dumps(for_json({"about": self.about, **self.data}), indent=1) + "\n")
        if docs is not None:
            replace_section(docs, name, [*nonempty(self.brief), Facts(self.about)])
        for path in (html, data, docs):
            if path is not None:
                print(f"written {path}")

    def write_beside(self, base: Path, docs: Path | None = None, name: str = "") -> None:
        """Write page, data and rows next to each other, as `base` with an ending; and the documentation's section."""
        html, data, table = (base.with_name(base.name + ending) for ending in (".html", ".json", ".csv"))
        self.write(html, data, docs, name)
        if self.rows:
            stream = io.StringIO()
            writer = csv.DictWriter(stream, list(dict.fromkeys(name for row in self.rows for name in row)))
            writer.writeheader()
            writer.writerows(self.rows)
            _write_text(table, stream.getvalue())
            print(f"written {table}")


def _write_text(path: Path, text: str) -> None:
    """Write a file, in a new folder if need be; a former one stays until all is written. Raises BadInput."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with replacing(path) as new:
        new.write_text(text, encoding="utf-8", newline="")


def nonempty(parts: Sequence[Part]) -> list[Part]:
    """Return the parts without empty texts and tables without rows."""
    return [part for part in parts if (part.rows if isinstance(part, Table) else part)]


def marks(name: str) -> tuple[str, str]:
    """Return the comments that enclose a measured section of a documentation page."""
    return f"<!-- measured: {name} -->", f"<!-- end: {name} -->"


def check_section(path: Path | None, name: str) -> None:
    """Raise BadInput if a page does not exist or has no such section; None stands for no page, and is valid."""
    if path is None:
        return
    begin, end = marks(name)
    text = path.read_text(encoding="utf-8") if path.is_file() else ""
    if text.count(begin) != 1 or text.count(end) != 1 or text.index(begin) > text.index(end):
        raise BadInput("the page has no section for this", str(path), remedy=f"add the lines {begin} and {end}")


def replace_section(path: Path, name: str, parts: Sequence[Part]) -> None:
    """Replace the content of a page's measured section by the parts, separated by blank lines.

    Figures become files in the folder `pictures` next to the page, named after the section and themselves, on white
    because pages may be dark.
    """
    check_section(path, name)
    begin, end = marks(name)
    text = path.read_text(encoding="utf-8")
    before, after = text[: text.index(begin)], text[text.index(end) :]
    written = [begin]
    for part in parts:
        if isinstance(part, Figure):
            picture = path.parent / "pictures" / ("-".join([*name.split(), *part.name.split()]) + ".svg")
            picture.parent.mkdir(exist_ok=True)
            picture.write_text(part.svg.replace("<svg ", '<svg style="background: #fff" ', 1), encoding="utf-8")
            written.append(f"![{part.caption}](pictures/{picture.name})")
        elif isinstance(part, Table):
            written.append(part.markdown())
        elif isinstance(part, Facts):
            written.append("\n".join(f"- {name}: {value}" for name, value in part.values.items()))
        else:
            written.append(str(part))
    _write_text(path, before + "\n\n".join([*written, after]))


@cache
def _template() -> jinja2.Template:
    loader = jinja2.FileSystemLoader(Path(__file__).parent)
    environment = jinja2.Environment(loader=loader, autoescape=True, trim_blocks=True, lstrip_blocks=True)
    environment.filters["text"] = _text
    return environment.get_template("page.html")


def _begins(text: str, words: Sequence[str]) -> bool:
    return any(text == word or text.startswith((word + " ", word + ",")) for word in words)


def _text(text: str) -> Markup:
    """Escape a text; parts between backticks become code."""
    return Markup(re.sub(r"`([^`]+)`", r"<code>\1</code>", str(escape(text))))


# Results of measurements: all samples, their bars, and whether these were met.

MOST_REASON = 360
"""Most characters of a reason in a table."""
SAME_TIME = 1.1
"""Medians within a tenth of each other count as the same, as everywhere in the benches."""


@dataclass(frozen=True)
class Result:
    """One measured quantity.

    samples          one value per repeat, in `unit`; empty if the measurement failed
    bar, aim         values that must and should be reached: at least, or at most if `at_most`
    compile_seconds  first call, with compiling or loading, which is not in the samples [s]
    limit            theoretical limit of the hardware, in the same unit
    failure          reason for missing samples
    """

    case: str
    what: str
    unit: str
    samples: tuple[float, ...] = ()
    bar: float | None = None
    aim: float | None = None
    at_most: bool = False
    compile_seconds: float | None = None
    limit: float | None = None
    note: str = ""
    failure: str = ""

    @property
    def median(self) -> float:
        return statistics.median(self.samples)

    @property
    def more_is_better(self) -> bool:
        """Whether more is better: for rates per second, but not for times, ratios and other counts."""
        return self.unit.endswith("/s")

    @property
    def verdict(self) -> str:
        """failed, missed, bar met, aim met, or "" without a bar."""
        if self.failure or not self.samples:
            return "failed"
        if self.bar is None:
            return ""
        if not self._reaches(self.bar):
            return "missed"
        return "aim met" if self.aim is not None and self._reaches(self.aim) else "bar met"

    def _reaches(self, wanted: float) -> bool:
        return self.median <= wanted if self.at_most else self.median >= wanted


HEADINGS = ("case", "what", "median", "min - max", "unit", "bar", "aim", "of limit", "first call", "verdict")


def table(results: Sequence[Result], caption: str = "") -> Table:
    """Return a table with one row per result, under HEADINGS."""
    return Table(HEADINGS, [_row(result) for result in results], caption)


def _row(result: Result) -> list[str]:
    sign = "<= " if result.at_most else ">= "
    wanted = [f"{sign}{number(value)}" if value is not None else "" for value in (result.bar, result.aim)]
    if not result.samples:
        return [result.case, result.what, "-", "", result.unit, *wanted, "", "", "failed"]
    share = f"{result.median / result.limit:.0%}" if result.limit else ""
    first = f"{result.compile_seconds:.2g} s" if result.compile_seconds is not None else ""
    median, spread = number(result.median), spread_of(result.samples)
    return [result.case, result.what, median, spread, result.unit, *wanted, share, first, result.verdict]


def spread_of(samples: Sequence[float]) -> str:
    """Return the smallest and largest sample as text."""
    return f"{number(min(samples))} - {number(max(samples))}" if len(samples) > 1 else "once"


def factor(a: float, b: float) -> float:
    """Return the factor between two errors or times, at least 1."""
    low, high = sorted((a, b))
    return high / low if low > 0.0 else (1.0 if high == 0.0 else float("inf"))


def apart(a: Sequence[float], b: Sequence[float]) -> bool:
    """Return whether two sets of repeats do not overlap, and their medians differ by more than a tenth.

    The spread of a single time is unknown, so the answer is no.
    """
    if min(len(a), len(b)) < 2:
        return False
    overlap = max(a) >= min(b) and max(b) >= min(a)
    return not overlap and factor(statistics.median(a), statistics.median(b)) > SAME_TIME


def number(value: float) -> str:
    """Return three significant digits, without an exponent for numbers of common size."""
    if value == 0 or 1e-3 <= abs(value) < 1e6:
        digits = f"{value:.3g}"
        return digits if "e" not in digits else f"{value:,.0f}"
    return f"{value:.0e}" if abs(value) >= 1e9 else f"{value:.3g}"


def reason_of(error: BadInput | RunFailed) -> str:
    """Return the reason for leaving out a solver, on one line, without the middle of long compiler messages."""
    text = error.problem if isinstance(error, BadInput) else " ".join(str(error).split())
    return text if len(text) <= MOST_REASON else f"{text[: MOST_REASON * 2 // 3]} ... {text[-MOST_REASON // 3 :]}"
