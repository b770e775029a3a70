"""Tubes of cloth put on a body, and how often they wind round it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from sewing_patterns import Body

from nuno.scene.files import SceneFiles
from nuno_cloth.models.pattern import Pattern, PatternConfig
from nuno_cloth.models.triangles import find_edges
from nuno_schemas.fabric import Fabric, Float


def put_on(folder: Path, cut: dict[str, Any], body: Body, edge: float = 0.02) -> Fabric:
    (folder / "one.json").write_text(json.dumps(cut))
    config = PatternConfig(file="one.json", edge=edge, over={"body": "wearer", "clearance": 0.01})  # type: ignore[arg-type]
    return Pattern().build_over(config, SceneFiles(folder), 0, *body)


def turns(cloth: Fabric, origin: Float, axis: Float) -> list[int]:
    """How often each opening goes round a line through a point."""
    edges = find_edges(cloth.faces)
    ways = {
        (int(a), int(b)) for k in range(3) for a, b in zip(cloth.faces[:, k], cloth.faces[:, (k + 1) % 3], strict=True)
    }
    after = {a: b for a, b in ways if (b, a) not in ways}
    assert len(after) == (edges.count == 1).sum()
    across = np.linalg.svd(axis[None])[2][1:]
    flat = (cloth.position - origin) @ across.T
    angle, found = np.arctan2(flat[:, 1], flat[:, 0]), []
    while after:
        here, whole = next(iter(after)), 0.0
        while here in after:
            there = after.pop(here)
            whole += (angle[there] - angle[here] + np.pi) % (2.0 * np.pi) - np.pi
            here = there
        found.append(round(whole / (2.0 * np.pi)))
    return sorted(found)
