"""A circle skirt is a flat ring: lengths, areas and angles of its cloth at rest are those in the plane."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from nuno.python_api.fit import MEASURED
from nuno_cloth.models.skirt import SHARES, Skirt, SkirtConfig
from nuno_contact.body_shapes.person import torso_mesh
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Fabric, Float

LENGTH, WAIST = 0.5, 0.12
BODY: dict[str, Any] = {"over": {"body": "b", "ease": 0.05}}


def build(cut: str, edge: float = 0.02, over: bool = False, **fields: object) -> Fabric:
    own = BODY if over else {"waist_radius": WAIST}
    config = SkirtConfig.model_validate(
        {"cut": cut, "length": LENGTH, "edge": edge, "fabric": "denim", **own, **fields}
    )
    if over:
        return Skirt().build_over(config, None, 0, *torso_mesh(48, arms=np.radians(55.0)))  # type: ignore[arg-type]
    return Skirt().build(config, None, 0)  # type: ignore[arg-type]


def corners(fabric: Fabric) -> Float:
    """(f, 3, 2) of each triangle at rest, along warp and weft from the first on [m], from what it is simulated with."""
    membrane = fabric.membrane
    assert membrane is not None
    sides = np.linalg.inv(np.stack([membrane.along, membrane.across], axis=2))
    return np.concatenate([np.zeros((len(sides), 1, 2)), sides.transpose(0, 2, 1)], axis=1)


def rows_of(fabric: Fabric) -> Float:
    """(n,) how far below the waist each vertex is, along the cloth [m]."""
    laid, up = fabric.laid_out, np.zeros(fabric.number)
    assert laid is not None
    up[fabric.faces] = laid.points[laid.faces][..., 1]
    return np.asarray(LENGTH * (1.0 - up))


def inner_radius(fabric: Fabric, part: float) -> float:
    """Of the ring, from its cloth's waist: n chords of a circle, the share `part` of it."""
    side = rest_sides(fabric, 0.0)
    return float(side.mean() / (2.0 * np.sin(np.pi * part / len(side))))


def rest_sides(fabric: Fabric, down: float) -> Float:
    """Lengths at rest [m] of the edges along a circle that lies so far below the waist [m]."""
    flat, on = corners(fabric), np.abs(rows_of(fabric)[fabric.faces] - down) < 1e-6
    found = {}
    for face, k in np.argwhere(on & np.roll(on, -1, axis=1)).tolist():
        ends = frozenset((int(fabric.faces[face, k]), int(fabric.faces[face, (k + 1) % 3])))
        found[ends] = float(np.linalg.norm(flat[face, (k + 1) % 3] - flat[face, k]))
    return np.array(list(found.values()))


@pytest.mark.quick(over=[True], cut=["circle"])
@pytest.mark.parametrize("over", [False, True])
@pytest.mark.parametrize("cut", SHARES)
def test_lengths_at_rest_are_those_in_the_plane(cut: str, over: bool) -> None:
    """Along each circle of radius r: n chords 2 r sin(pi f / n). The waist is as long as it is worn."""
    fabric, part = build(cut, over=over), SHARES[cut]
    first = inner_radius(fabric, part)
    waist = fabric.position[fabric.pinned]
    worn = np.linalg.norm(waist - np.roll(waist, 1, axis=0), axis=1).sum()
    assert 2.0 * np.pi * part * first == pytest.approx(worn, rel=15.0 / len(waist) ** 2)
    if not over:
        assert first == pytest.approx(WAIST / part, rel=1e-12)
    for down in np.unique(rows_of(fabric).round(6)):
        side = rest_sides(fabric, float(down))
        chord = 2.0 * (first + down) * np.sin(np.pi * part / len(side))
        assert side == pytest.approx(np.full(len(side), chord), rel=1e-5)  # rows are told by float32


@pytest.mark.parametrize("cut", SHARES)
def test_its_cloth_is_flat_everywhere(cut: str) -> None:
    """Round each vertex inside, angles add up to a full turn; what those along the hem are short of half a turn adds up
    to the share of a full one that is cut, and at the waist to as much the other way.
    """
    fabric, part = build(cut), SHARES[cut]
    flat = corners(fabric)
    ahead, behind = np.roll(flat, -1, axis=1) - flat, np.roll(flat, 1, axis=1) - flat
    cross = ahead[..., 0] * behind[..., 1] - ahead[..., 1] * behind[..., 0]
    angle = np.arctan2(np.abs(cross), (ahead * behind).sum(axis=2))
    total = np.bincount(fabric.faces.reshape(-1), angle.reshape(-1))
    down = rows_of(fabric)
    waist, hem = fabric.pinned, down > LENGTH - 1e-6
    assert total[~waist & ~hem] == pytest.approx(np.full((~waist & ~hem).sum(), 2.0 * np.pi), abs=1e-9)
    assert (np.pi - total[hem]).sum() == pytest.approx(2.0 * np.pi * part, abs=1e-9)
    assert (np.pi - total[waist]).sum() == pytest.approx(-2.0 * np.pi * part, abs=1e-9)


@pytest.mark.parametrize("cut", SHARES)
def test_its_area_and_its_mass_are_the_rings(cut: str) -> None:
    """Between polygons of n corners, n r^2 sin(2 pi f / n) / 2 each: pi f (R^2 - r^2) but for chords."""
    fabric, part, first = build(cut), SHARES[cut], WAIST / SHARES[cut]
    assert fabric.membrane is not None
    area = float(fabric.membrane.area.sum())
    down = rows_of(fabric)
    number = np.array([fabric.pinned.sum(), (down > LENGTH - 1e-6).sum()])
    within = 0.5 * number * np.array([first, first + LENGTH]) ** 2 * np.sin(2.0 * np.pi * part / number)
    assert area == pytest.approx(within[1] - within[0], rel=1e-12)
    assert area == pytest.approx(np.pi * part * ((first + LENGTH) ** 2 - first**2), rel=1e-3)
    assert fabric.mass.sum() == pytest.approx(0.324 * area, rel=1e-12)


def test_yarns_run_one_way_in_the_plane() -> None:
    """Down the middle of the front, and so across the sides of a full circle."""
    fabric = build("circle")
    flat, x = corners(fabric), fabric.position[fabric.faces]
    down = rows_of(fabric)[fabric.faces]
    gradient = np.linalg.solve(flat[:, 1:] - flat[:, :1], (down[:, 1:] - down[:, :1])[..., None])[..., 0]
    middle = x.mean(axis=1)
    front, left = (np.abs(middle[:, axis]) < 0.02 for axis in (0, 2))
    assert np.abs(gradient[front & (middle[:, 2] > 0.0), 0]).min() > 0.95
    assert np.abs(gradient[left, 0]).max() < 0.35


@pytest.mark.parametrize("cut", ["half", "quarter"])
def test_half_a_circle_starts_as_a_cone_without_strain(cut: str) -> None:
    """A cone is as flat as a plane; but for chords of its waist."""
    fabric = build(cut)
    flat, x = corners(fabric), fabric.position[fabric.faces]
    stretched = np.linalg.norm(np.roll(x, -1, axis=1) - x, axis=2)
    rest = np.linalg.norm(np.roll(flat, -1, axis=1) - flat, axis=2)
    assert np.abs(stretched / rest - 1.0).max() < 0.01


def test_constants_per_spring_and_hems_wider_than_the_cloth_are_refused() -> None:
    with pytest.raises(BadInput, match="no membrane"):
        build("half", fabric={"density": 0.2, "structural": 30})
    with pytest.raises(BadInput, match="wider than it is cut") as caught:
        build("half", hem_radius=0.5)
    assert caught.value.field == "hem_radius"


def test_fit_names_the_skirts_that_it_measures() -> None:
    for cut in SHARES:
        assert cut in MEASURED and build(cut, edge=0.05).membrane is not None
    cone = SkirtConfig.model_validate({"waist_radius": WAIST, "length": LENGTH, "fabric": "denim"})
    assert Skirt().build(cone, None, 0).membrane is None  # type: ignore[arg-type]


@pytest.mark.parametrize("ratio", [1.0, 0.6])
def test_waist_and_hem_are_as_long_as_circles_however_flat(ratio: float) -> None:
    config = SkirtConfig.model_validate(
        {"waist_radius": 0.12, "hem_radius": 0.3, "ratio": ratio, "columns": 128, "rows": 50, "fabric": "denim"}
    )
    x = Skirt().build(config, None, 0).position  # type: ignore[arg-type]
    for row, radius in ((x[:128], 0.12), (x[-128:], 0.3)):
        assert np.ptp(row[:, 2]) / np.ptp(row[:, 0]) == pytest.approx(ratio, rel=1e-3)
        length = np.linalg.norm(np.roll(row, -1, axis=0) - row, axis=1).sum()
        assert length == pytest.approx(2.0 * np.pi * radius, rel=5e-3)
