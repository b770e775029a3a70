"""Makes the sight of a scene, or of a run's messages."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nuno.bus.encodings import BadMessage
from nuno.collision.bodies import NO_SURFACES, Surfaces, build_bodies, surface
from nuno.exports.cloth import INSET, colour_of
from nuno.scene.scene_file import Loaded
from nuno.simulation import cloth
from nuno.simulation.cloth import join_fabrics
from nuno.simulation.yarns import structural_edges
from nuno.studio.live_view.snapshot import NO_POINTS, Sight
from nuno_schemas.bodies import Geometry
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Fabric, Float, Int

GROUND = 4.0
"""Edge of the square that represents a plane, in sizes of the cloth."""


def draw_bodies(geometry: Geometry | None, size: float) -> Surfaces:
    """Return the surfaces of a scene's bodies for cloth of a size [m]."""
    return NO_SURFACES if geometry is None else surface(geometry, INSET, GROUND * size)


def size_of(x: Float) -> float:
    """Return the diagonal of the bounding box of the finite points among (n, 3) [m]."""
    finite = x[np.isfinite(x).all(axis=1)]
    return float(np.linalg.norm(np.ptp(finite, axis=0))) if len(finite) else 1.0


def see_scene(loaded: Loaded) -> tuple[Sight, Fabric]:
    """Return a scene's cloth at the start, and its fabric. Raises BadInput for a scene without cloth."""
    return see_objects(loaded)[:2]


def see_objects(loaded: Loaded) -> tuple[Sight, Fabric, list[Fabric]]:
    """Return a scene's cloth at the start, its fabric, and each object's. Raises BadInput for a scene without cloth."""
    if not loaded.scene.moves:
        remedy = "name a scene with objects, such as hanging-sheet"
        raise BadInput("there is no cloth here that moves", value=loaded.scene.name, remedy=remedy)
    bodies = build_bodies(loaded) if loaded.scene.bodies else None
    geometry, poses = (bodies.geometry, bodies.poses(0.0)) if bodies else (None, None)
    fabrics = cloth.build_fabrics(loaded, geometry, poses)
    fabric, pieces = join_fabrics(fabrics, loaded.scene.name), cloth.place_pieces(loaded, fabrics)
    drawn = draw_bodies(geometry, size_of(fabric.position))
    edges, rest = structural_edges(fabric)
    sight = Sight(
        fabric.position,
        fabric.faces,
        _coloured(pieces, fabric.faces),
        drawn.at(poses) if poses is not None else NO_POINTS,
        drawn.faces,
        edges,
        rest.astype(np.float32),
        frames=loaded.scene.frames,
    )
    return sight, fabric, fabrics


def see_now(arrays: Mapping[str, NDArray[Any]], text: Mapping[str, Any]) -> Sight:
    """Decode a run's answer about its cloth, without its bodies. Raises BadMessage."""
    try:
        pieces = [cloth.Piece(o["name"], int(o["start"]), int(o["stop"]), colour=o["colour"]) for o in text["objects"]]
        x, faces, edges, rest = (arrays[name] for name in ("x", "faces", "edges", "edge_rest"))
        sight = Sight(x, faces, tuple(pieces), edges=edges, rest=rest, frame=int(text["frame"]), t=float(text["t"]))
    except (KeyError, TypeError, ValueError) as error:
        raise BadMessage(f"cloth without {error}") from None
    if x.shape[1:] != (3,) or not (
        _joins(faces, 3, len(x)) and _joins(edges, 2, len(x)) and rest.shape == edges.shape[:1]
    ):
        raise BadMessage(f"cloth of {x.shape} positions, {faces.shape} triangles and {edges.shape} links")
    return replace(sight, pieces=_coloured(pieces, faces))


def _coloured(pieces: Iterable[cloth.Piece], faces: Int) -> tuple[cloth.Piece, ...]:
    """Give objects of triangles (f, 3) without a colour that of pictures, as `cut_pieces` does."""
    first = faces[:, 0] if faces.size else np.zeros(0, np.int32)
    return tuple(
        piece if piece.colour or not ((first >= piece.start) & (first < piece.stop)).any()
        else replace(piece, colour=colour_of(i))
        for i, piece in enumerate(pieces)
    )  # fmt: skip


def _joins(rows: NDArray[Any], corners: int, count: int) -> bool:
    """Return whether rows have `corners` columns of indices below `count`."""
    return rows.shape[1:] == (corners,) and (rows.size == 0 or bool(0 <= rows.min() <= rows.max() < count))
