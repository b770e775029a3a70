"""The garments of a recording, and the body that wears them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from nuno.collision.bodies import build_bodies, surface, vertex_normals
from nuno.exports.cloth import ShownPiece, read_pieces
from nuno.fit.measure import Fit, measure, measure_pressure
from nuno.fit.places import find_heights
from nuno.fit.seams import measure_seams
from nuno.recording.reader import Recording
from nuno.replay.frame_state import FrameState, states
from nuno.scene.recorded_scene import restored_scene
from nuno.scene.scene_file import Loaded
from nuno.simulation.yarns import named_heights
from nuno_schemas.bodies import OF_TRIANGLES
from nuno_schemas.errors import BadInput, nearest
from nuno_schemas.fabric import Float, Int, Membrane

Mesh = tuple[Float, Int]
"""Vertices (m, 3) [m] and faces (g, 3)."""
MEASURED = "use a pattern, shirt, mesh or skirt with cut: circle, half or quarter, of a preset fabric, not of springs"
CONTACTS = ("contact", "cloth_contact")


def read_fits(
    recording: Recording, frame: int | None = None, body: str | None = None, heights: dict[str, float] | None = None
) -> list[Fit]:
    """Measure the fit of each garment of a frame (default: the last) on a body (default: the only one).

    heights [m] are above the body's lowest point, by name, and override the body's own. Raises BadInput for a recording
    without such a body, or without a garment of measured fabric.
    """
    numbers = sorted(number for number, _ in recording.marks().values())
    if not numbers:
        raise BadInput("the recording holds no frames", str(recording.path))
    (moment,) = states(recording, [numbers[-1] if frame is None else frame], forces=True)
    with restored_scene(recording) as loaded:
        mesh, landmarks, search = wearer(loaded, body, moment.t, str(recording.path))
    floor = float(mesh[0][:, 1].min())
    at = (landmarks or find_heights(*mesh)) | {name: floor + height for name, height in (heights or {}).items()}
    at = dict(sorted(at.items(), key=lambda one: -one[1]))
    normals = _normals(mesh, search(moment.x))
    fits = [fit for piece in read_pieces(recording) if (fit := _fit(piece, moment, mesh, at, normals))]
    if not fits:
        problem = "no garment of a measured fabric, whose triangles were cut"
        raise BadInput(problem, str(recording.path), remedy=MEASURED)
    return [replace(fit, girths=[replace(one, height=one.height - floor) for one in fit.girths],
                    openings=[replace(one, low=one.low - floor, high=one.high - floor) for one in fit.openings])
            for fit in fits]  # fmt: skip


def _fit(piece: ShownPiece, moment: FrameState, mesh: Mesh, at: dict[str, float], normals: Float) -> Fit | None:
    """Measure the fit of a piece; None for a piece without a membrane."""
    fabric, forces, start, stop = moment.fabric, moment.forces, piece.start, piece.stop
    if fabric is None or forces is None or fabric.membrane is None:
        return None
    whole = fabric.membrane
    part = (whole.faces[:, 0] >= start) & (whole.faces[:, 0] < stop)
    if not part.any():
        return None
    faces = (whole.faces[part] - start).astype(np.int32)
    membrane = Membrane(faces, whole.along[part], whole.across[part], whole.area[part], whole.moduli[:, part],
                        whole.damping[:, part])  # fmt: skip
    x = moment.x[start:stop]
    corners = piece.corners
    if corners is not None and not np.array_equal(faces, corners.vertex[corners.faces]):
        corners = None
    fit = measure(piece.name, x, membrane, mesh, at, None if corners is None else corners.panels)
    force = sum((forces.parts[kind][start:stop] for kind in CONTACTS if kind in forces.parts), 0.0 * x)
    seams = [] if corners is None else measure_seams(x, membrane, corners)
    return replace(fit, pressed=measure_pressure(membrane, force, normals[start:stop]), seams=seams)


def _normals(mesh: Mesh, closest: Any) -> Float:
    """Return the normals (n, 3) of a body at its closest points."""
    of_corners = vertex_normals(*mesh)[mesh[1][closest.face]]
    normal = np.einsum("nc,ncd->nd", closest.weights, of_corners)
    return np.asarray(normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300))


def wearer(
    loaded: Loaded, name: str | None, t: float, path: str
) -> tuple[Mesh, dict[str, float], Callable[[Float], Any]]:
    """Return a body's mesh at t [s], its own named heights [m], and a function that finds its closest points.

    name is None for the only body; path is the recording's. Raises BadInput if there is no such body of triangles.
    """
    names = [one.name for one in loaded.scene.bodies]
    if not names:
        raise BadInput("the recording has no body to fit", path)
    if name is None and len(names) > 1:
        raise BadInput("which body wears it is not said", path, field="--body", limit=", ".join(names))
    if name is not None and name not in names:
        raise BadInput("no such body", path, field="--body", value=name, remedy=nearest(name, names))
    number = 0 if name is None else names.index(name)
    bodies = build_bodies(loaded)
    geometry = bodies.geometry
    parts = [int(i) for i in np.flatnonzero(geometry.body == number)]
    collider = loaded.colliders[number].plugin
    if not parts or any(geometry.kind[i] not in OF_TRIANGLES for i in parts) or not hasattr(collider, "search"):
        problem, remedy = "fit is measured on a body of triangles", "give it a mesh as its collider"
        raise BadInput(problem, path, field="--body", value=names[number], remedy=remedy)
    shown = surface(geometry.of_primitives(parts))
    heights = named_heights(loaded) if len(names) == 1 else {}
    mesh = np.ascontiguousarray(shown.at(bodies.poses(t))), shown.faces
    return mesh, heights, collider.search(*mesh)
