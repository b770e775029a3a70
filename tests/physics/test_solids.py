"""Boxes, cylinders and cones: closed, as large as they should be, and rounded by the radius that is asked for."""

from __future__ import annotations

import math

import numpy as np
import pytest
import trimesh
from pydantic import ValidationError

from nuno_contact.colliders.mesh import MeshConfig, box_mesh, cone_mesh

SIZE = (0.4, 0.7, 0.3)
CASES = [("box", 1.0, 0.0), ("box", 1.0, 0.05), ("box", 1.0, 0.149), ("cone", 1.0, 0.0), ("cone", 1.0, 0.05),
         ("cone", 0.4, 0.05), ("cone", 0.0, 0.0), ("cone", 0.0, 0.04)]  # fmt: skip


def made(
    kind: str, top: float, rounding: float, resolution: int, size: tuple[float, float, float] = SIZE
) -> trimesh.Trimesh:
    x, faces = box_mesh(size, rounding, resolution) if kind == "box" else cone_mesh(size, top, rounding, resolution)
    return trimesh.Trimesh(x, faces, process=False)


def volume(kind: str, top: float, r: float) -> float:
    """Of a box, the convex body that Steiner's formula has; of a round cone, its outline turned about the axis."""
    if kind == "box":
        a, b, c = (side - 2.0 * r for side in SIZE)
        edges = math.pi * r * r * (a + b + c) + 4.0 / 3.0 * math.pi * r**3
        return a * b * c + 2.0 * r * (a * b + b * c + c * a) + edges
    from nuno_contact.colliders.mesh import _outline

    radius, y = _outline(0.5 * SIZE[0], 0.5 * top * SIZE[0], SIZE[1], r, 1e-4).T
    frustums = np.diff(y) * (radius[1:] ** 2 + radius[1:] * radius[:-1] + radius[:-1] ** 2) / 3.0
    return math.pi * float(frustums.sum()) * SIZE[2] / SIZE[0]


@pytest.mark.parametrize(("kind", "top", "rounding"), CASES)
def test_it_is_closed_and_its_volume_comes_to_the_closed_form(kind: str, top: float, rounding: float) -> None:
    errors = []
    for resolution in (48, 96, 192):
        mesh = made(kind, top, rounding, resolution)
        assert mesh.is_watertight and mesh.is_winding_consistent and mesh.volume > 0.0
        assert (np.ptp(mesh.vertices, axis=0) <= np.array(SIZE) + 1e-9).all()
        assert mesh.vertices[:, 1].min() == pytest.approx(-0.5 * SIZE[1], abs=1e-12)
        assert len(np.unique(mesh.faces)) == len(mesh.vertices)
        errors.append(abs(mesh.volume / volume(kind, top, rounding) - 1.0))
    exact = kind == "box" and rounding == 0.0
    assert errors[-1] < (1e-12 if exact else 1e-3)
    # By the square of the triangles' sides; but round edges have a few sides however coarse it is.
    assert exact or errors[0] / errors[-1] > (15.0 if rounding == 0.0 else 3.0)


@pytest.mark.parametrize("rounding", [0.02, 0.05])
def test_edges_are_rounded_by_their_radius(rounding: float) -> None:
    """Vertices lie on the surface of what is as far from the box within."""
    x = made("box", 1.0, rounding, 64).vertices
    half = 0.5 * np.array(SIZE)
    inner = np.clip(x, rounding - half, half - rounding)
    np.testing.assert_allclose(np.linalg.norm(x - inner, axis=1), rounding, rtol=1e-12)
    # Of a cylinder, whose edge is a ring, as well.
    x = made("cone", 1.0, rounding, 64, (0.4, 0.7, 0.4)).vertices
    around, up = np.hypot(x[:, 0], x[:, 2]), np.abs(x[:, 1])
    edge = (around > 0.2 - rounding + 1e-9) & (up > 0.35 - rounding + 1e-9)
    assert edge.sum() > 200
    np.testing.assert_allclose(np.hypot(around - (0.2 - rounding), up - (0.35 - rounding))[edge], rounding, rtol=1e-9)


WRONG = {
    "no size": ({"shape": "box"}, "needs its size"),
    "too round": ({"shape": "box", "size": [0.4, 0.7, 0.3], "rounding": "16 cm"}, "at most 0.1498"),
    "a leg's size": ({"shape": "leg", "size": [0.4, 0.7, 0.3]}, "size are for shape: box"),
    "a box's top": ({"shape": "box", "size": [0.4, 0.7, 0.3], "top": 0.5}, "a box is as wide above as below"),
    "a solid's arms": ({"shape": "cone", "size": [0.4, 0.7, 0.3], "arms": "50 deg"}, "only mannequins"),
    "a file's size": ({"shape": "box", "file": "a.obj", "size": [0.4, 0.7, 0.3]}, "a file has its scale"),
    "a flat one": ({"shape": "cylinder", "size": [0.4, 0.0, 0.3]}, "greater than 0"),
}


@pytest.mark.parametrize("case", WRONG)
def test_what_is_no_solid_is_refused(case: str) -> None:
    fields, said = WRONG[case]
    with pytest.raises(ValidationError, match=said):
        MeshConfig.model_validate(fields)
