"""Tables of a documentation page, put there by the command that measured them and by nobody else."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

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


def check_section(path: Path, name: str) -> None:
    """Raises BadInput where a page does not exist or has no such section."""
    begin, end = marks(name)
    text = path.read_text(encoding="utf-8") if path.is_file() else ""
    if text.count(begin) != 1 or text.count(end) != 1 or text.index(begin) > text.index(end):
        raise BadInput("the page has no section for this", str(path), remedy=f"add the lines {begin} and {end}")


def replace_section(path: Path, name: str, parts: Sequence[str]) -> None:
    """Put the parts, a blank line between them, in the place of what the section holds."""
    check_section(path, name)
    begin, end = marks(name)
    text = path.read_text(encoding="utf-8")
    before, after = text[: text.index(begin)], text[text.index(end) :]
    path.write_text(before + "\n\n".join([begin, *parts, after]), encoding="utf-8")
