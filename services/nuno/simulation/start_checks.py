"""Checks of the cloth's start: near the frame that it is attached to, and outside bodies.

Attached vertices keep their place in the frame from the start on: a skirt without its centre
would be dragged along from a metre away, without an error.
"""

from __future__ import annotations

import numpy as np

from nuno.collision.distance import penetration, signed_distance
from nuno.scene.scene_file import Loaded
from nuno.scene.warnings import SEEN_DEPTH
from nuno_schemas.bodies import BOX, OF_TRIANGLES, PLANE, Geometry, Poses, check_size
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Fabric, Float

FARTHEST = 2.0
"""Largest distance of attached cloth from the body's surface, in radii of the body there. A waist
lies within a few centimetres; a cape on a chest that is attached to the hips within one radius."""


def check_wearer(loaded: Loaded, body: str, x: Float) -> None:
    """Raise BadInput for a body x (v, 3) [m] of an impossible size: its file may be in another unit."""
    collider = loaded.colliders[[one.name for one in loaded.scene.bodies].index(body)]
    check_size(x, body, float(getattr(collider.config, "scale", 1.0)))


def check_worn(x: Float, geometry: Geometry, poses: Poses, frame: int) -> None:
    """Raise BadInput where attached vertices x (n, 3) [m] start far from their frame, an index.

    The nearest of the vertices and their centre counts: a flag is held at one end, and a wide
    ring has its centre on the body. Planes are infinite, so nothing is far from them.
    """
    places = np.concatenate([x, x.mean(axis=0, keepdims=True)])
    distance, radius = _nearest(places, geometry, poses, frame)
    if distance <= FARTHEST * radius:
        return
    centre = ", ".join(f"{value:.3g}" for value in poses.translation[frame])
    raise BadInput(
        "cloth is attached to a frame that it is far from",
        value=f"{geometry.frames[frame]}: {distance:.3g} m from the body's surface there",
        limit=f"{FARTHEST * radius:.3g} m, {FARTHEST:g} times the body's radius there",
        remedy=f"place the cloth at the frame, which starts at [{centre}] m, or attach it to a nearer frame",
    )


def start_warnings(fabric: Fabric, x: Float, geometry: Geometry | None, poses: Poses | None) -> list[str]:
    """Return the warnings about cloth at x (n, 3) [m] before its first step, with bodies or without.

    A body through a held edge is not an error: capsules are rough bodies, and a worn waistband may cut a little into
    one. But nothing moves held vertices out of a body, as contact does with free ones.
    """
    warnings = _loose(fabric, x)
    if geometry is None or poses is None:
        return warnings
    depth = penetration(x, geometry, poses)
    if inside := _inside_text(depth, "vertices"):
        warnings.append(f"{inside}: place or size the cloth, or move the body, otherwise")
    if inside := _inside_text(depth[fabric.pinned], "held vertices"):
        warnings.append(f"a body is through the edge that is held: {inside}, and stay there: widen or move that edge")
    return warnings


def _loose(fabric: Fabric, x: Float) -> list[str]:
    """Return a warning of springs with a rest length whose ends coincide: they have no direction to push in."""
    springs = fabric.springs
    pairs = springs.pairs() if springs is not None else np.zeros((0, 2), np.int32)
    loose = (x[pairs[:, 0]] == x[pairs[:, 1]]).all(axis=1)
    if springs is None or not (loose := loose & (springs.per_spring(springs.rest) > 0.0)).any():
        return []
    i, j = pairs[loose][0] if fabric.numbers is None else fabric.numbers[pairs[loose][0]]
    number = f"{np.count_nonzero(loose):,} of {len(pairs):,} springs start with both ends at the same place"
    return [f"{number}, such as vertices {i} and {j}: they do not push until these part: place them apart"]


def _inside_text(depth: Float, what: str) -> str:
    """Return the number of vertices at depths (n,) [m] in bodies, in words; "" if none is visibly inside."""
    most = float(depth.max(initial=0.0))
    number = f"{np.count_nonzero(depth):,} of {len(depth):,} {what}"
    return f"{number} start in a body, up to {most * 1e3:.3g} mm deep" if most > SEEN_DEPTH else ""


def _nearest(places: Float, geometry: Geometry, poses: Poses, frame: int) -> tuple[float, float]:
    """Return the distance of places (m, 3) to the nearest primitive of the frame, and its radius [m].

    A frame without primitives counts as a ball around its origin, with the body's largest radius.
    """
    distances = [
        (float(signed_distance(places, geometry.of_primitives([i]), poses).min()), _radius(geometry, i))
        for i in np.flatnonzero(geometry.frame == frame).tolist()
    ]
    if distances:
        return min(distances)
    body = geometry.bodies.index(geometry.frames[frame].partition("/")[0])
    radius = max((_radius(geometry, i) for i in np.flatnonzero(geometry.body == body).tolist()), default=0.0)
    return float(np.linalg.norm(places - poses.translation[frame], axis=1).min()) - radius, radius


def _radius(geometry: Geometry, i: int) -> float:
    if geometry.kind[i] == PLANE:
        return np.inf
    if geometry.kind[i] in OF_TRIANGLES:
        return float(0.5 * (geometry.b[i] - geometry.a[i]).max())
    return float(geometry.b[i].max() if geometry.kind[i] == BOX else geometry.radius[i])
