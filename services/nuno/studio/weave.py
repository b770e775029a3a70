"""Scenes of cloth that is woven after a draft and dyed, from files dropped on the page."""

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
"""Cells along a side: smaller drafts are repeated, larger cloth gets larger cells, as far as its yarns allow."""
BATH = 0.85
"""Diameter of the bath over the shorter side of the cloth."""


def weave(scene: Path, draft: str, stencil: str) -> Path:
    """Write a scene with a whole draft, or a twill; a stencil, if given, keeps dye out. Raises BadInput."""
    text = f"Cloth woven after {draft or 'a twill'}, dyed with indigo{f' around {stencil}' if stencil else ''}."
    image = {"kind": "image", "file": stencil and _grey(scene.parent, stencil), "fit": "stretch"}
    changes = [_as("description", text), _as("dye.cloth.resist", [image] if stencil else [])]
    if draft:
        changes.append(_as("dye.cloth.weave.file", draft))
        try:
            cells = _woven(scene, [*changes, _as("dye.cloth.cells", None)])
        except BadInput as error:
            if not str(error.field).endswith("Spacing"):
                raise
            # The file has no spacing of its yarns: use that of other weaves.
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
    """Build the cloth of a scene before it is dyed. Raises BadInput if it cannot be woven."""
    return build_cloth(load_after(AFTER, scene, [*changes, _as("dye.cloth.supply", [])]))[0]


def _grey(folder: Path, stencil: str) -> str:
    """Return the name of a stencil as a grey PNG: the file itself, or a converted copy next to it."""
    with Image.open(folder / stencil) as picture:
        if picture.format == "PNG" and picture.mode in ("1", "L", "LA", "I", "I;16"):
            return stencil
        grey = io.BytesIO()
        upright(picture).convert("LA" if "A" in picture.getbands() else "L").save(grey, "PNG")
    with tempfile.NamedTemporaryFile() as file:
        file.write(grey.getvalue())
        file.flush()
        target = reserve(folder, f"{Path(stencil).stem}-grey.png", Path(file.name))
    target.write_bytes(grey.getvalue())
    return target.name
