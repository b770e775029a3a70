"""Pieces of a page in Markdown."""

from __future__ import annotations

from collections.abc import Sequence


def table(headings: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Rows under headings; columns in which no row has anything are left out."""
    used = [i for i in range(len(headings)) if not rows or any(row[i] for row in rows)]
    lines = [[line[i].replace("|", "\\|") for i in used] for line in (headings, ["---"] * len(headings), *rows)]
    return "\n".join("| " + " | ".join(cells) + " |" for cells in lines)


def plain(text: str | None) -> str:
    """A docstring's first paragraph in one line, with what a page would take for markup as it was meant."""
    paragraph = " ".join((text or "").strip().split("\n\n")[0].split())
    return paragraph.replace("*", "\\*").replace("<", "\\<")


def anchor(heading: str) -> str:
    """Of a heading of letters, digits, blanks, brackets and underscores, as code hosts and the site have it."""
    return heading.lower().replace(" ", "-").replace("(", "").replace(")", "").replace(".", "")
