"""A garment on coarser triangles, taken over to finer ones."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from sewing_patterns import panel, pattern, read_pattern, stitch

from nuno.scene.files import SceneFiles
from nuno_cloth.sewing.refine import refine
from nuno_cloth.sewing.sew import Sewn, sew
from nuno_schemas.fabric import Float

CURVED = {0: {"type": "quadratic", "params": [[0.5, -0.2]]}, 2: {"type": "circle", "params": [30, 0, 1]}}


def plate(folder: Path, edge: float, gathered: float = 10.0) -> Sewn:
    """Two panels with curved hems, sewn along a straight edge, onto which one of them may be gathered."""
    corners = ((0, 0), (gathered, 0), (gathered, 20), (0, 20))
    one, other = panel(*corners, curves=CURVED), panel((0, 0), (10, 0), (10, 20), (0, 20), curves=CURVED)
    cut = pattern({"one": one, "other": other}, stitch("one[1]", "other[3]"))
    (folder / "plate.json").write_text(json.dumps(cut))
    return sew(read_pattern(SceneFiles(folder), "plate.json"), edge)


def laid(sewn: Sewn) -> Float:
    """(n, 2) where vertices are with the panels side by side, their edges along the seam on each other."""
    side = np.zeros(len(sewn.flat), bool)
    side[sewn.faces[sewn.panel == 1]] = True
    x = np.empty((sewn.number, 2))
    x[sewn.merged] = sewn.flat + np.where(side[:, None], [0.1, 0.0], 0.0)
    return x


@pytest.mark.parametrize("edges", [(0.02, 0.007), (0.03, 0.02), (0.01, 0.02)])
def test_what_is_linear_over_the_panels_is_taken_over_exactly(tmp_path: Path, edges: tuple[float, float]) -> None:
    """Across the seam, and where a curve of finer sides bulges beyond the coarser ones."""
    coarse, fine = (plate(tmp_path, edge) for edge in edges)
    turn = np.array([[0.3, -1.0, 0.2], [0.9, 0.1, -0.7]])
    places = [laid(coarse) @ turn + [1.0, 2.0, 3.0], np.zeros((coarse.number, 3))]
    found, none = refine(fine, coarse, places)
    np.testing.assert_allclose(found, laid(fine) @ turn + [1.0, 2.0, 3.0], atol=1e-12)
    assert not none.any()


def test_what_is_curved_is_taken_over_the_better_the_finer_the_coarse_triangles_are(tmp_path: Path) -> None:
    """Of second order: a quarter of the error at half the length of edges."""
    fine = plate(tmp_path, 0.004)

    def bend(flat: Float) -> Float:
        return np.stack([0.05 * np.sin(flat[:, 0] / 0.05), flat[:, 1], 0.05 * np.cos(flat[:, 0] / 0.05)], axis=1)

    errors = []
    for edge in (0.04, 0.02, 0.01):
        coarse = plate(tmp_path, edge)
        (found,) = refine(fine, coarse, [bend(laid(coarse))])
        errors.append(np.sqrt(((found - bend(laid(fine))) ** 2).mean()))
    assert errors[1] < 0.4 * errors[0] and errors[2] < 0.4 * errors[1] and errors[2] < 3e-4


def test_along_a_seam_both_panels_are_heard(tmp_path: Path) -> None:
    """Of a seam whose edges lie 2 cm apart on the coarser garment as it is read by either panel there is one place
    only: vertices of a gathered seam lie on it, as far along as they are sewn.
    """
    coarse, fine = plate(tmp_path, 0.02, 15.0), plate(tmp_path, 0.008, 15.0)
    (seam,) = fine.seams
    x = np.zeros((coarse.number, 3))
    on = coarse.merged[coarse.seams[0].pairs[:, 0]]
    x[on, 1] = np.linspace(0.0, 1.0, len(on))
    (found,) = refine(fine, coarse, [x])
    along = found[fine.merged[seam.pairs[:, 0]], 1]
    np.testing.assert_allclose(along, np.linspace(0.0, 1.0, len(along)), atol=1e-9)
