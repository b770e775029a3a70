"""From a scene, or from what a run says of itself, to what the page shows."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nuno.cloth import build
from nuno.collision.bodies import build_bodies
from nuno.collision.surfaces import NO_SURFACES, Surfaces, surface
from nuno.draw.sight import NO_POINTS, Sight
from nuno.scene.scene_file import Loaded
from nuno.wire.arrays import BadMessage
from nuno_schemas.bodies import Geometry
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Fabric, Float

STRUCTURAL = 0
"""Kind of springs that are the cloth's threads (nuno_schemas.fabric.Springs)."""
GROUND = 4.0
"""Edge of the patch that a plane is drawn as, in sizes of the cloth."""


def draw_bodies(geometry: Geometry | None, size: float) -> Surfaces:
    """A scene's bodies beside cloth of a size [m]; none for a scene without."""
    return NO_SURFACES if geometry is None else surface(geometry, plane_size=GROUND * size)


def size_of(x: Float) -> float:
    """Diagonal of the box about finite points (n, 3) [m]."""
    finite = x[np.isfinite(x).all(axis=1)]
    return float(np.linalg.norm(np.ptp(finite, axis=0))) if len(finite) else 1.0


def see_scene(loaded: Loaded) -> Sight:
    """The cloth of a scene as it is at the start. Raises BadInput for one without triangles."""
    if not loaded.scene.moves:
        remedy = "name a scene with objects, such as hanging-sheet"
        raise BadInput("there is no cloth here to draw ridges and valleys on", value=loaded.scene.name, remedy=remedy)
    bodies = build_bodies(loaded) if loaded.scene.bodies else None
    geometry, poses = (bodies.geometry, bodies.poses(0.0)) if bodies else (None, None)
    fabric, pieces = build.build_fabric(loaded, geometry, poses)
    if not len(fabric.faces):
        remedy = "draw on a sheet, a skirt or a mesh; a net of yarns has no surface"
        raise loaded.at("objects[0].model", BadInput("cloth without triangles cannot be drawn on", remedy=remedy))
    require_springs(loaded, fabric)
    drawn = draw_bodies(geometry, size_of(fabric.position))
    return Sight(
        fabric.position,
        fabric.faces,
        tuple(pieces),
        drawn.at(poses) if poses is not None else NO_POINTS,
        drawn.faces,
        frames=loaded.scene.frames,
    )


def require_springs(loaded: Loaded, fabric: Fabric) -> None:
    """Raises BadInput for cloth of no edge of whose triangles lines could be raised: those need springs there."""
    springs = fabric.springs
    count = fabric.number
    structural = np.zeros((0, 2), np.int64)
    if springs is not None:
        structural = springs.pairs()[springs.of_kind(STRUCTURAL)].astype(np.int64)
    known = np.sort(structural, axis=1) @ np.array([count, 1])
    edges = np.sort(np.stack([fabric.faces, np.roll(fabric.faces, -1, axis=1)], axis=2).astype(np.int64), axis=2)
    if not np.isin(edges @ np.array([count, 1]), known).all(axis=1).any():
        remedy = "give a mesh or a shirt tension: springs, a sheet or skirt cells: triangles"
        problem = "lines cannot be drawn on this cloth: it has no springs along the edges of its triangles"
        raise loaded.at("objects[0].model", BadInput(problem, remedy=remedy))


def see_now(arrays: Mapping[str, NDArray[Any]], text: Mapping[str, Any]) -> Sight:
    """A run's answer to where its cloth is, without its bodies. Raises BadMessage."""
    try:
        pieces = tuple(
            build.Piece(o["name"], int(o["start"]), int(o["stop"]), colour=o["colour"]) for o in text["objects"]
        )
        x, faces = arrays["x"], arrays["faces"]
        sight = Sight(x, faces, pieces, frame=int(text["frame"]), t=float(text["t"]))
    except (KeyError, TypeError, ValueError) as error:
        raise BadMessage(f"cloth without {error}") from None
    if (
        x.shape[1:] != (3,)
        or faces.shape[1:] != (3,)
        or not (faces.size == 0 or 0 <= faces.min() <= faces.max() < len(x))
    ):
        raise BadMessage(f"cloth of {x.shape} positions and {faces.shape} triangles")
    return sight
