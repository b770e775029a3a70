"""Tables of a documentation page, put there by the command that measured them and by nobody else."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from nuno_bench.report.page import Facts, Figure, Part, Table
from nuno_schemas.errors import BadInput


def table(headings: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A pipe table."""
    lines = [headings, ["---"] * len(headings), *rows]
    return "\n".join("| " + " | ".join(cell.replace("|", "\\|") for cell in line) + " |" for line in lines)


def facts(values: Mapping[str, str]) -> str:
    """A list of names and values."""
    return "\n".join(f"- {name}: {value}" for name, value in values.items())


def marks(name: str) -> tuple[str, str]:
    """The comments between which a page's measured section stands."""
    return f"<!-- measured: {name} -->", f"<!-- end: {name} -->"


def check_section(path: Path | None, name: str) -> None:
    """Raises BadInput where a page does not exist or has no such section; None is no page, and fine."""
    if path is None:
        return
    begin, end = marks(name)
    text = path.read_text(encoding="utf-8") if path.is_file() else ""
    if text.count(begin) != 1 or text.count(end) != 1 or text.index(begin) > text.index(end):
        raise BadInput("the page has no section for this", str(path), remedy=f"add the lines {begin} and {end}")


def replace_section(path: Path, name: str, parts: Sequence[Part]) -> None:
    """Put the parts, a blank line between them, in the place of what the section holds.

    Figures become files in the folder `pictures` beside the page, named after the section and themselves, on white
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
            written.append(table(part.headings, part.rows))
        else:
            written.append(facts(part.values) if isinstance(part, Facts) else str(part))
    path.write_text(before + "\n\n".join([*written, after]), encoding="utf-8")
