"""Cloth as it is drawn: on a smooth surface through the simulated vertices, with thick hems, without cracks."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import ConvexHull

from nuno_render.refine import HEM, THICK, refine
from nuno_schemas.pictures import Mesh, frame


def ball(number: int) -> Mesh:
    """A closed sheet of triangles between points spread evenly on the unit sphere."""
    k = np.arange(number) + 0.5
    z, turn = 1.0 - 2.0 * k / number, k * np.pi * (3.0 - np.sqrt(5.0))
    x = np.stack([np.sqrt(1.0 - z * z) * np.cos(turn), np.sqrt(1.0 - z * z) * np.sin(turn), z], axis=1)
    faces = ConvexHull(x).simplices
    normal = np.cross(x[faces[:, 1]] - x[faces[:, 0]], x[faces[:, 2]] - x[faces[:, 0]])
    inwards = (normal * x[faces].sum(axis=1)).sum(axis=1) < 0.0
    faces[inwards] = faces[inwards][:, ::-1]
    return Mesh(x, faces.astype(np.int32))


def sheet(cut: bool, bend: float = 0.0, n: int = 9) -> Mesh:
    """A square of a metre, bent along x, whose texture is cut in the middle if asked for."""
    s, t = (a.ravel() for a in np.meshgrid(np.linspace(0.0, 1.0, n), np.linspace(0.0, 1.0, n)))
    x = np.stack([s, t, bend * np.sin(5.0 * s) * t], axis=1)
    index = np.arange(n * n).reshape(n, n)
    a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, :-1], index[1:, 1:]
    faces = np.concatenate([np.stack(one, -1).reshape(-1, 3) for one in ((a, b, c), (b, d, c))])
    uv = np.stack([s, t], axis=1)
    if cut:
        middle = n // 2
        twin = np.arange(n * n)
        twin[index[:, middle]] = n * n + np.arange(n)
        right = x[faces][:, :, 0].mean(axis=1) > s[index[0, middle]]
        faces[right] = twin[faces[right]]
        x, uv = np.concatenate([x, x[index[:, middle]]]), np.concatenate([uv, uv[index[:, middle]] + [1.0, 0.0]])
    return Mesh(x, faces.astype(np.int32), uv=uv.astype(np.float32))


def drawn(mesh: Mesh) -> Mesh:
    (fine,) = refine([mesh], frame([mesh], size=(960, 720)))
    assert len(fine.faces) > 4 * len(mesh.faces)
    return fine


def rows(x: np.ndarray) -> set[bytes]:
    return {row.tobytes() for row in x + 0.0}


@pytest.mark.parametrize("mesh", [ball(150), sheet(True, 0.1)])
def test_every_vertex_is_kept_to_the_bit(mesh: Mesh) -> None:
    assert rows(mesh.vertices) <= rows(drawn(mesh).vertices)


def test_a_coarse_sphere_is_nearly_round() -> None:
    """The smooth surface is off the sphere by a fifth of what flat triangles are, and its normals by 8 degrees."""
    mesh = ball(150)
    fine = drawn(mesh)
    assert fine.normals is not None
    flat = 1.0 - np.linalg.norm(mesh.vertices[mesh.faces].mean(axis=1), axis=1).min()
    middles = np.linalg.norm(fine.vertices[fine.faces].mean(axis=1), axis=1)
    assert np.abs(middles - 1.0).max() < 0.2 * flat
    turned = 1.0 - (fine.normals * fine.vertices).sum(axis=1) / np.linalg.norm(fine.vertices, axis=1)
    assert turned.max() < 0.01


def test_a_seam_of_the_texture_is_no_crack() -> None:
    """The surface with a cut texture has the points and normals of the one without, and each half its own texture."""
    whole, cut = drawn(sheet(False, 0.1)), drawn(sheet(True, 0.1))
    surface = 2 * 64 * 15  # of 15 points a triangle; hems and seams follow
    assert np.array_equal(whole.vertices[:surface], cut.vertices[:surface])
    assert np.array_equal(whole.normals[:surface], cut.normals[:surface])  # type: ignore[index]
    assert whole.uv is not None and cut.uv is not None
    apart = np.round(cut.uv[:surface] - whole.uv[:surface], 5) + 0.0
    middle, left = whole.uv[:surface, 0] == 0.5, whole.uv[:surface, 0] < 0.5
    assert set(apart[middle, 0]) == {0.0, 1.0} and not apart[left].any() and not apart[:, 1].any()
    flat = drawn(sheet(False))
    assert flat.uv is not None and np.allclose(flat.uv[:surface], flat.vertices[:surface, :2], atol=1e-6)


def test_a_flat_sheet_stays_flat_and_its_hem_has_a_thickness() -> None:
    fine = drawn(sheet(False))
    assert np.ptp(fine.vertices[:, 2]) == pytest.approx(THICK, rel=1e-6)
    thick = np.abs(fine.vertices[:, 2]) > 0.4 * THICK
    inside = fine.vertices[:, :2].clip(0.0, 1.0)
    edge = np.minimum(inside, 1.0 - inside).min(axis=1)
    assert edge[thick].max() < 1.01 * THICK * np.abs(HEM).max()
    assert fine.vertices[:, :2].min() == pytest.approx(-THICK * HEM[:, 0].max(), rel=1e-6)


def test_a_round_body_is_not_changed_and_a_box_has_creases() -> None:
    """A box's normals are those of its sides, and its surface is the same."""
    smooth = replace(ball(50), two_sided=False)
    corners = np.array([[i, j, k] for i in (0.0, 1.0) for j in (0.0, 1.0) for k in (0.0, 1.0)])
    hull = ConvexHull(corners)
    faces = np.array([f if e[:3] @ np.cross(*(corners[f[1:]] - corners[f[0]])) > 0.0 else f[::-1]
                      for f, e in zip(hull.simplices, hull.equations, strict=True)])  # fmt: skip
    box = Mesh(corners, faces.astype(np.int32), two_sided=False)
    same, creased = refine([smooth, box], frame([smooth, box]))
    assert same is smooth
    assert creased.normals is not None
    assert np.array_equal(np.sort(np.abs(creased.normals), axis=1), np.tile([0.0, 0.0, 1.0], (36, 1)))
    assert np.array_equal(creased.vertices[creased.faces], corners[faces])


def test_layers_in_contact_are_not_bent_towards_each_other() -> None:
    """Each by itself is round between its vertices; near each other both are as flat as their triangles."""
    mesh = sheet(False, 0.1)
    other = replace(mesh, vertices=mesh.vertices + np.array([0.0, 0.0, 1e-3]))
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    normal /= np.linalg.norm(normal, axis=1)[:, None]

    def off(fine: Mesh) -> float:
        """The farthest that the points on each triangle, which come first, are off it."""
        points = fine.vertices[: 15 * len(a)].reshape(len(a), 15, 3)
        return float(np.abs(((points - a[:, None]) * normal[:, None]).sum(axis=2)).max())

    near, _ = refine([mesh, other], frame([mesh, other], size=(960, 720)))
    assert off(drawn(mesh)) > 1e-3
    assert off(near) < 1e-12
