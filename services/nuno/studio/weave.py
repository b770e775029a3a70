"""Scenes of cloth that is woven after a draft and dyed, with what is dropped on the page."""

from __future__ import annotations

import contextlib
import io
import math
import tempfile
from collections.abc import Sequence
from pathlib import Path

from PIL import Image

from nuno.dye.run import build_cloth
from nuno.scene.override import as_override as _as
from nuno.studio.arrivals import reserve
from nuno.templates.shipped import load_after, write_after
from nuno_schemas.colour import upright
from nuno_schemas.dye import Cells
from nuno_schemas.errors import BadInput

AFTER = "dye/draft"
FEWEST_CELLS, MOST_CELLS = 320, 600
"""Along a side: a draft of fewer is repeated, and cloth of more is woven in larger ones, as far as its yarns allow."""
BATH = 0.85
"""How wide the bath is that cloth is dipped into, as a share of the shorter side."""


def weave(scene: Path, draft: str, stencil: str) -> Path:
    """Write a scene: all of a draft, or of a twill; a stencil, where one is given, keeps dye out. Raises BadInput."""
    told = f"Cloth woven after {draft or 'a twill'}, dyed with indigo{f' around {stencil}' if stencil else ''}."
    image = {"kind": "image", "file": stencil and _grey(scene.parent, stencil), "fit": "stretch"}
    changes = [_as("description", told), _as("dye.cloth.resist", [image] if stencil else [])]
    if draft:
        changes.append(_as("dye.cloth.weave.file", draft))
        try:
            cells = _woven(scene, [*changes, _as("dye.cloth.cells", None)])
        except BadInput as error:
            if not str(error.field).endswith("Spacing"):
                raise
            # The file does not say how far its yarns are apart: they are as those of other weaves.
            changes.append(_as("dye.cloth.weave.measured", False))
            cells = _woven(scene, [*changes, _as("dye.cloth.cells", None)])
        nx, ny = (n * math.ceil(FEWEST_CELLS / n) for n in cells.fibre.shape[:0:-1])
        changes.append(_as("dye.cloth.cells", [nx, ny]))
        for times in range(math.ceil(max(nx, ny) / MOST_CELLS), 1, -1):
            coarser = [*changes, _as("dye.cloth.coarser", times)]
            with contextlib.suppress(BadInput):  # a yarn, or a gap, would be narrower than a cell
                _woven(scene, coarser)
                changes = coarser
                break
        width, height = nx * cells.size, ny * cells.size
        middle = [round(0.5 * side, 5) for side in (width, height)]
        region = {"shape": "disc", "centre": middle, "diameter": round(BATH * min(width, height), 5)}
        changes.append(_as("dye.cloth.supply", [{"kind": "bath", "region": region, "amount": 0.9}]))
    return write_after(AFTER, scene, changes)[-1]


def _woven(scene: Path, changes: Sequence[str]) -> Cells:
    """The cloth of a scene before it is dyed. Raises BadInput where it cannot be woven so."""
    return build_cloth(load_after(AFTER, scene, [*changes, _as("dye.cloth.supply", [])]))[0]


def _grey(folder: Path, stencil: str) -> str:
    """The name of a stencil as cloth takes it, a grey PNG: itself, or one beside it that has its greys."""
    with Image.open(folder / stencil) as picture:
        if picture.format == "PNG" and picture.mode in ("1", "L", "LA", "I", "I;16"):
            return stencil
        grey = io.BytesIO()
        upright(picture).convert("LA" if "A" in picture.getbands() else "L").save(grey, "PNG")
    with tempfile.NamedTemporaryFile() as file:
        file.write(grey.getvalue())
        file.flush()
        there = reserve(folder, f"{Path(stencil).stem}-grey.png", Path(file.name))
    there.write_bytes(grey.getvalue())
    return there.name
