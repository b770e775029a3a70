"""Weaves drawn on the page: opened from drafts, and saved as drafts."""

from __future__ import annotations

import re
from pathlib import Path

from nuno.plugin_contract import registry
from nuno.studio.scenes import check_target, write_whole
from nuno_schemas.errors import BadInput
from nuno_schemas.pictures import DrawnDraft

MOST_YARNS = 100
"""The most ends, and the most picks, of a weave that is drawn."""
NEW = re.compile(r"[A-Za-z0-9][\w.-]{0,100}\.wif", re.ASCII)
"""Allowed names of a new draft."""


def open_draft(path: Path) -> dict[str, object]:
    """Return the drawdown of a draft as rows of 0 and 1, and its text if the file holds no more: then it may be
    saved over. Raises BadInput, also for a draft that is too large to draw.
    """
    cloth = registry.offering("nuno.dye_cloths", "write_draft", "writes drafts")
    drawn: DrawnDraft = cloth.draw_draft(path)
    _check_size(*drawn.drawdown.shape)
    rows = ["".join(map(str, row)) for row in drawn.drawdown.astype(int).tolist()]
    text: str = cloth.write_draft(rows)
    return {"rows": rows, "text": text if path.read_bytes() == text.encode() else None}


def save_draft(rows: object, name: object, before: object, folder: Path) -> tuple[Path, str]:
    """Write a weave into a new WIF file of the folder, or into one with the text `before`, as the page has saved it;
    return its path and text. Raises BadInput.
    """
    name = f"{name}.wif" if isinstance(name, str) and name and "." not in name else name
    if not isinstance(name, str) or not NEW.fullmatch(name):
        limit = "letters, digits, - _ ., and at its end .wif or nothing"
        raise BadInput("not the name of a draft's file", field="name", value=name, limit=limit)
    if not isinstance(rows, list) or not all(isinstance(row, str) for row in rows):
        raise BadInput("a weave has rows", field="rows", limit="texts of 0 and 1")
    _check_size(len(rows), max(map(len, rows), default=0))
    text: str = registry.offering("nuno.dye_cloths", "write_draft", "writes drafts").write_draft(rows)
    check_target(folder / name, before if isinstance(before, str) else None)
    write_whole(folder / name, text)
    return folder / name, text


def _check_size(picks: int, ends: int) -> None:
    if not 1 <= min(picks, ends) <= max(picks, ends) <= MOST_YARNS:
        raise BadInput(
            "not the size of a weave that is drawn here", field="rows", value=f"{picks} picks x {ends} ends",
            limit=f"1 to {MOST_YARNS} each", remedy="draw one repeat: cloth repeats it",
        )  # fmt: skip
