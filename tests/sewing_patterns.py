"""Small patterns, a body for them, and real ones where they lie beside the project."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from nuno.scene.files import SceneFiles
from nuno_cloth.sewing.pattern import Pattern
from nuno_cloth.sewing.pattern_file import PatternFile, require_sound
from nuno_schemas.fabric import Float, Int

Body = tuple[Float, Int]

REAL = ("shirt", "hoody", "dress-pencil", "jumpsuit", *(f"p{k:02d}" for k in range(24)))
"""GarmentCode's own, and some that were sampled with its programs."""
FEW = ("shirt", "jumpsuit", "p09", "p19", "p22")
"""Of these, some that have among them all that the others have: every kind of curve, darts, gathers, a seam with its
right side on a wrong one, vertices that are inside once sewn, and two, three, four and five openings.
"""


def column(radii: tuple[float, float], height: tuple[float, float], around: int = 64) -> Body:
    """An upright elliptic column, closed above and below."""
    turn = 2.0 * np.pi * np.arange(around) / around
    levels = np.linspace(*height, 24)
    rings = [np.stack([radii[0] * np.sin(turn), 0.0 * turn + y, radii[1] * np.cos(turn)], axis=1) for y in levels]
    x = np.concatenate([*rings, [[0.0, levels[0], 0.0], [0.0, levels[-1], 0.0]]])
    i = np.arange(around)
    j, last = (i + 1) % around, (len(levels) - 1) * around
    sides = [
        np.concatenate([np.stack([a + i, a + j, b + j], axis=1), np.stack([a + i, b + j, b + i], axis=1)])
        for a, b in ((k * around, (k + 1) * around) for k in range(len(levels) - 1))
    ]
    ends = np.stack([j, i, 0 * i + len(x) - 2], axis=1), np.stack([last + i, last + j, 0 * i + len(x) - 1], axis=1)
    return x, np.concatenate([*sides, *ends]).astype(np.int32)


def together(*bodies: Body) -> Body:
    """One mesh, whose parts may stand in each other."""
    first = np.cumsum([0, *(len(x) for x, _ in bodies)])
    faces = [faces + np.int32(at) for (_, faces), at in zip(bodies, first, strict=False)]
    return np.concatenate([x for x, _ in bodies]), np.concatenate(faces)


def moved(body: Body, turn: Float, shift: Sequence[float]) -> Body:
    """Turned (3, 3) about the origin, then shifted (3,) [m]."""
    return np.ascontiguousarray(body[0] @ turn.T + np.asarray(shift)), body[1]


def panel(*corners: tuple[float, float], curves: Mapping[int, Any] | None = None, **fields: Any) -> dict[str, Any]:
    """Straight edges from corner to corner [cm], or with the curvature of their number."""
    edges = [
        {"endpoints": [k, (k + 1) % len(corners)]} | ({"curvature": curves[k]} if curves and k in curves else {})
        for k in range(len(corners))
    ]
    return {"vertices": [list(corner) for corner in corners], "edges": edges, **fields}


def stitch(one: str, other: str, *more: str) -> list[Any]:
    """Of edges by their names: `front[1]`."""
    sides = [side.rstrip("]").split("[") for side in (one, other)]
    return [*({"panel": name, "edge": int(edge)} for name, edge in sides), *more]


def pattern(panels: Mapping[str, Any], *stitches: list[Any], **properties: Any) -> dict[str, Any]:
    return {
        "pattern": {"panels": dict(panels), "stitches": list(stitches)},
        "properties": {"units_in_meter": 100, "curvature_coords": "relative"} | properties,
    }


def front(width: float = 30.0, height: float = 20.0) -> dict[str, Any]:
    """Edges: hem, left of the wearer, top, right."""
    return panel((0, 0), (width, 0), (width, height), (0, height), translation=[-width / 2, 100, 15])


def back(width: float = 30.0, height: float = 20.0) -> dict[str, Any]:
    """As the front, seen through it; so it is drawn clockwise. Edges: right, top, left, hem."""
    return panel((0, 0), (0, height), (width, height), (width, 0), translation=[-width / 2, 100, -15])


def tube(**changed: Any) -> dict[str, Any]:
    """Front and back, sewn along both sides; open above and below."""
    seams = stitch("front[1]", "back[2]"), stitch("front[3]", "back[0]")
    return pattern({"front": front(), "back": back()} | changed, *seams)


def read_pattern(files: SceneFiles, name: str) -> Pattern:
    return require_sound(files.read(name, PatternFile))


def read(folder: Path, data: Mapping[str, Any], name: str = "pattern.json") -> Pattern:
    (folder / name).write_text(json.dumps(data, indent=1))
    return read_pattern(SceneFiles(folder), name)
