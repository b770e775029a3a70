"""Elements of a Markdown page."""

from __future__ import annotations

from collections.abc import Sequence


def table(headings: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return a table of rows under headings, without empty columns."""
    used = [i for i in range(len(headings)) if not rows or any(row[i] for row in rows)]
    lines = [[line[i].replace("|", "\\|") for i in used] for line in (headings, ["---"] * len(headings), *rows)]
    return "\n".join("| " + " | ".join(cells) + " |" for cells in lines)


def plain(text: str | None) -> str:
    """Return a docstring's first paragraph in one line, with markup characters escaped."""
    paragraph = " ".join((text or "").strip().split("\n\n")[0].split())
    return paragraph.replace("*", "\\*").replace("<", "\\<")


def anchor(heading: str) -> str:
    """Return the anchor of a heading of letters, digits, blanks, brackets and underscores, as code hosts make it."""
    return heading.lower().replace(" ", "-").replace("(", "").replace(")", "").replace(".", "")
