"""What models build: counts, orientation, mass, springs, texture, and refusals by name."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from model_files import Folder, build, files
from pydantic import ValidationError

from nuno_cloth.fabrics.presets import PRESETS
from nuno_cloth.models.mesh import Mesh
from nuno_cloth.models.sheet import Sheet
from nuno_cloth.models.skirt import Skirt
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Fabric, Float
from nuno_testing import contract

__all__ = ["files"]


PLAIN = {"density": 0.2, "structural": 30, "bending": 2}

test_smallest = contract(
    "nuno.models",
    sheet={"resolution": [2, 2], "fabric": {**PLAIN, "shear": 5}},
    skirt={"columns": 4, "rows": 2, "fabric": {**PLAIN, "hinge": 1e-6}},
)
test_narrow = contract("nuno.models", sheet={"resolution": [2, 4], "size": [0.1, 0.3], "pin": ["all-rim"]})
test_ring = contract("nuno.models", skirt={"cut": "half", "edge": 0.04})
test_poncho = contract("nuno.models", swatch={"radius": 0.4, "hole": 0.11, "edge": 0.04, "over": {"body": "b"}})
test_worn = pytest.mark.full(
    contract("nuno.models", skirt={"over": {"body": "b"}, "columns": 48, "rows": 12, "pleats": 6})
)
test_worn_ring = pytest.mark.full(contract("nuno.models", skirt={"over": {"body": "b"}, "cut": "circle", "edge": 0.04}))
test_small = contract("nuno.models", sheet={"resolution": [3, 3]})


@pytest.mark.parametrize(("plane", "normal"), [("xy", (0, 0, 1)), ("xz", (0, 1, 0)), ("yz", (1, 0, 0))])
def test_sheets_face_where_they_say(plane: str, normal: tuple[int, int, int], files: Folder) -> None:
    fabric = build(Sheet(), {"plane": plane, "resolution": (4, 5), "centre": (1, 2, 3)}, files)
    assert face_normals(fabric) == pytest.approx(np.tile(normal, (24, 1)), abs=1e-12)
    assert fabric.position.mean(axis=0) == pytest.approx([1, 2, 3])
    if plane != "xz":
        assert fabric.position[0, 1] > fabric.position[-1, 1], "the first row is the top"


def face_normals(fabric: Fabric) -> Float:
    corner = fabric.position[fabric.faces]
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    unit: Float = normal / np.linalg.norm(normal, axis=1)[:, None]
    return unit


def test_rotation_turns_about_the_centre(files: Folder) -> None:
    flat = build(Sheet(), {"centre": (1, 2, 3)}, files)
    turned = build(Sheet(), {"centre": (1, 2, 3), "rotate": {"axis": (1, 0, 0), "angle": "90 deg"}}, files)
    x, y = (flat.position - [1, 2, 3])[:, 0], (flat.position - [1, 2, 3])[:, 1]
    assert turned.position - [1, 2, 3] == pytest.approx(np.stack([x, 0 * y, y], 1), abs=1e-12)


def test_sheet_counts_and_mass(files: Folder) -> None:
    rows, cols = 5, 7
    fabric = build(Sheet(), {"resolution": (cols, rows), "size": (0.6, 0.4), "fabric": "trousers"}, files)
    assert fabric.springs is not None and fabric.hinges is not None
    assert fabric.springs.number == rows * (cols - 1) + (rows - 1) * cols + 2 * (rows - 1) * (cols - 1)
    assert fabric.hinges.number == (rows - 2) * cols + rows * (cols - 2) + (rows - 1) * (cols - 1)
    assert fabric.mass.sum() == pytest.approx(0.220 * 0.24, rel=1e-12)
    assert fabric.faces.shape == (2 * (rows - 1) * (cols - 1), 3)
    lengths = np.linalg.norm(np.diff(fabric.position[fabric.springs.pairs()], axis=1)[:, 0], axis=1)
    assert lengths == pytest.approx(fabric.springs.per_spring(fabric.springs.rest), rel=1e-12)


def test_papers_grid_has_twelve_springs_a_vertex(files: Folder) -> None:
    rows, cols = 6, 8
    by_hand = {"density": 0.1, "structural": 50, "shear": 20, "bending": 5}
    fabric = build(Sheet(), {"resolution": (cols, rows), "fabric": by_hand}, files)
    assert fabric.springs is not None
    inner = np.bincount(fabric.springs.pairs().ravel())[2 * cols + 2 : 2 * cols + cols - 2]
    assert (inner == 12).all()
    assert fabric.hinges is None


def test_runs_stay_few(files: Folder) -> None:
    """Memory of springs and hinges grows with the rows, not with the vertices."""
    fabric = build(Sheet(), {"resolution": (200, 100)}, files)
    assert fabric.springs is not None and fabric.hinges is not None
    assert len(fabric.springs.count) < 7 * 100 and len(fabric.hinges.count) < 6 * 100
    assert fabric.springs.k.shape == fabric.springs.count.shape


@pytest.mark.parametrize("config", [{}, {"fullness": 1.4, "pleats": 8}, {"ratio": 0.75}, {"hem_radius": 0.13}])
def test_skirts_are_closed_and_face_outward(config: dict[str, Any], files: Folder) -> None:
    fabric = build(Skirt(), {"columns": 64, "rows": 12, **config}, files)
    normal, middle = face_normals(fabric), fabric.position[fabric.faces].mean(axis=1)
    assert (normal[:, [0, 2]] * middle[:, [0, 2]]).sum(axis=1).min() > 0
    edges = np.sort(np.concatenate([fabric.faces[:, [0, 1]], fabric.faces[:, [1, 2]], fabric.faces[:, [2, 0]]]), axis=1)
    _, count = np.unique(edges, axis=0, return_counts=True)
    assert (count == 1).sum() == 2 * 64, "only waist and hem are open"
    assert fabric.pinned.sum() == 64 and fabric.pinned[:64].all()
    assert fabric.springs is not None
    assert fabric.springs.number == 64 * (12 + 3 * 11)


def test_a_plain_skirt_starts_unstretched(files: Folder) -> None:
    """But for chords against arcs: 1 - cos(pi / columns)."""
    fabric = build(Skirt(), {"columns": 64, "rows": 12}, files)
    assert np.abs(strains(fabric)).max() < 1.01 * (1 - np.cos(np.pi / 64))


def test_pleats_start_unstretched_but_for_shear(files: Folder) -> None:
    fabric = build(Skirt(), {"columns": 128, "rows": 24, "fullness": 1.4, "pleats": 12}, files)
    assert fabric.springs is not None
    structural = np.repeat(fabric.springs.kind, fabric.springs.count) == 0
    strain = np.abs(strains(fabric))
    assert strain[structural].max() < 1e-3 and strain.max() < 0.02
    hem = fabric.position[-128:]
    radius = np.hypot(hem[:, 0], hem[:, 2])
    folds = np.flatnonzero((radius > np.roll(radius, 1)) & (radius >= np.roll(radius, -1)))
    assert len(folds) == 12 and np.ptp(radius) > 0.03


def strains(fabric: Fabric) -> Float:
    assert fabric.springs is not None
    lengths = np.linalg.norm(np.diff(fabric.position[fabric.springs.pairs()], axis=1)[:, 0], axis=1)
    strain: Float = lengths / fabric.springs.per_spring(fabric.springs.rest) - 1
    return strain


def test_the_waist_is_bound(files: Folder) -> None:
    fabric = build(Skirt(), {"columns": 32, "attach": {"body": "dancer", "frame": "hips"}}, files)
    (binding,) = fabric.bindings
    assert (binding.body, binding.frame) == ("dancer", "hips")
    assert binding.vertices.dtype == np.int32 and binding.vertices.tolist() == list(range(32))


@pytest.mark.parametrize(
    ("model", "config"),
    [(Sheet(), {}), (Skirt(), {}), (Skirt(), {"columns": 4, "rows": 3}), (Skirt(), {"cells": "triangles"}),
     (Skirt(), {"cut": "circle", "edge": 0.04}), (Skirt(), {"cut": "quarter", "length": 0.2, "edge": 0.03})],
)  # fmt: skip
def test_the_image_covers_the_cloth_once_and_is_seen_from_outside(
    model: Any, config: dict[str, Any], files: Folder
) -> None:
    fabric = build(model, {"texture": "image.png", **config}, files)
    laid = fabric.laid_out
    assert laid is not None and laid.points.dtype == np.float32
    np.testing.assert_array_equal(laid.vertex[laid.faces], fabric.faces)
    assert laid.points.min(axis=0).tolist() == [0, 0] and laid.points.max(axis=0).tolist() == [1, 1]
    assert (
        laid.points[laid.vertex == 0, 1].tolist()[0] == 1 and laid.points[laid.vertex == fabric.number - 1, 1][0] == 0
    )
    one, other = np.moveaxis(np.diff(laid.points[laid.faces].astype(float), axis=1), 1, 0)
    area = 0.5 * (one[:, 0] * other[:, 1] - one[:, 1] * other[:, 0])
    # Where a ring's rows begin half a step apart, the image is cut there: a narrow strip on every other row.
    lost = 0.25 / np.bincount(np.unique(np.round(laid.points[:, 1], 6), return_inverse=True)[1]).min()
    assert (area > 0.0).all() and area.sum() == pytest.approx(1.0, abs=lost if config.get("cut") else 1e-6)
    assert fabric.texture == str(files.root / "image.png")
    with pytest.raises(BadInput):
        build(model, {"texture": "missing.png"}, files)


@pytest.mark.parametrize(
    ("pin", "expected"),
    [
        (["top-row"], [0, 1, 2]),
        (["left-edge"], [0, 3, 6, 9]),
        (["corners"], [0, 2, 9, 11]),
        (["top-corners"], [0, 2]),
        (["bottom-right", 4], [4, 11]),
        (["all-rim"], [0, 1, 2, 3, 5, 6, 8, 9, 10, 11]),
    ],
)
def test_pins_by_name(pin: list[str | int], expected: list[int], files: Folder) -> None:
    assert np.flatnonzero(build(Sheet(), {"resolution": (3, 4), "pin": pin}, files).pinned).tolist() == expected


@pytest.mark.parametrize("vertex", [-1, 12])
def test_pins_that_do_not_exist_are_refused(vertex: int, files: Folder) -> None:
    with pytest.raises(BadInput) as caught:
        build(Sheet(), {"resolution": (3, 4), "pin": ["top-row", vertex]}, files)
    assert caught.value.field == "pin[1]" and caught.value.value == vertex


@pytest.mark.parametrize(
    ("model", "config", "text"),
    [
        (Sheet(), {"fabric": "denym"}, "did you mean 'denim'"),
        (Sheet(), {"fabric": {"preset": "denim", "density": "3 s"}}, "cannot be converted"),
        (Sheet(), {"fabric": {"density": 0.2, "warp": 100}}, "missing: weft, shear, bend_warp, bend_weft"),
        (Sheet(), {"size": (1, -1)}, "greater than 0"),
        (Sheet(), {"resolution": (1, 5)}, "greater than or equal to 2"),
        (Sheet(), {"rotate": {"axis": (0, 0, 0), "angle": 1}}, "zero vector"),
        (Skirt(), {"columns": 33}, "must be even"),
    ],
)
def test_bad_configuration_is_refused(model: Any, config: dict[str, Any], text: str) -> None:
    with pytest.raises(ValidationError, match=text):
        model.Config.model_validate(config)


@pytest.mark.parametrize(
    ("model", "config", "field"),
    [
        (Sheet(), {"resolution": (5, 50), "fabric": "interlock"}, "resolution"),
        (Skirt(), {"hem_radius": 0.8}, "hem_radius"),
        (Skirt(), {"fullness": 1.5, "columns": 64, "pleats": 12}, "columns"),
    ],
)
def test_impossible_cloth_is_refused(model: Any, config: dict[str, Any], field: str, files: Folder) -> None:
    with pytest.raises(BadInput) as caught:
        build(model, config, files)
    assert caught.value.field == field and caught.value.limit and caught.value.remedy


def test_overrides_of_a_preset(files: Folder) -> None:
    fabric = build(Sheet(), {"size": (1, 1), "fabric": {"preset": "denim", "density": "100 g/m^2"}}, files)
    assert fabric.mass.sum() == pytest.approx(0.1)
    assert all(material.source for material in PRESETS.values())


BY_HAND = {"density": 0.2, "structural": [30, 50], "shear": 5, "bending": [2, 3], "damping_ratio": 0.1}


@pytest.mark.parametrize(
    ("model", "config"),
    [(Sheet(), {"resolution": (7, 5)}), (Mesh(), {"file": "sheet.obj"})],
    ids=["sheet", "mesh"],
)
def test_damping_ratio_of_constants_by_hand_is_that_of_every_spring(
    model: Any, config: dict[str, Any], files: Folder
) -> None:
    """c = 2 ratio sqrt(k m) with the reduced mass m of the two ends, inside of the borders."""
    springs = (fabric := build(model, {**config, "fabric": BY_HAND}, files)).springs
    assert springs is not None
    pairs = springs.pairs()
    one, other = fabric.mass[pairs[:, 0]], fabric.mass[pairs[:, 1]]
    ratio = springs.per_spring(springs.c) / (2 * np.sqrt(springs.per_spring(springs.k) * one * other / (one + other)))
    inside = slice(None) if isinstance(model, Mesh) else (one == one.max()) & (other == other.max())
    np.testing.assert_allclose(ratio[inside], 0.1, rtol=1e-12)
    assert len(ratio[inside]) > 4
