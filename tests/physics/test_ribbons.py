"""Ribbons, few triangles and slivers of a measured fabric: stiffness and step where curvatures hardly show."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import scipy.sparse
from scipy.integrate import cumulative_trapezoid
from triangle_sheets import matrix

from nuno.scene.files import SceneFiles
from nuno_cloth.fabrics.presets import Material
from nuno_cloth.models.bending import build_bending, plate
from nuno_cloth.models.bending_friction import build_friction
from nuno_cloth.models.delaunay import triangulate
from nuno_cloth.models.mesh import Mesh, MeshConfig
from nuno_cloth.models.patches import flip_slivers
from nuno_cloth.models.triangles import yarn_axes
from nuno_schemas.fabric import Bool, Fabric, Float, Int
from nuno_schemas.vectors import face_areas

CELL = 0.01
CLOTH = Material(0.05, 400.0, 400.0, 30.0, 5e-5, 5e-5)
CURLS = replace(CLOTH, bend_poisson=0.3)
LONG = 32


def ribbon(wide: int, alternate: bool, jitter: float, across: bool = True, seed: int = 0) -> tuple[Float, Int, Bool]:
    """Points [cells] and triangles of LONG cells; those of the first cell are held. Others are off by `jitter` cells,
    on the border `across` it, too.
    """
    column, row = (part.reshape(-1) for part in np.meshgrid(np.arange(LONG + 1), np.arange(wide + 1), indexing="ij"))
    corner = (np.arange(LONG)[:, None] * (wide + 1) + np.arange(wide)).reshape(-1)
    a, b, c, d = corner, corner + wide + 1, corner + wide + 2, corner + 1
    other = (alternate & ((column[a] + row[a]) % 2 == 1))[:, None, None]
    one, two = (
        np.stack([np.stack(t, 1) for t in pair], 1) for pair in (((a, b, d), (b, c, d)), ((a, b, c), (a, c, d)))
    )
    off = np.random.default_rng(seed).uniform(-jitter, jitter, (len(column), 2))
    off[(column == 0) | (column == LONG), 0] = 0.0
    off[((row == 0) | (row == wide)) & (not across), 1] = 0.0
    held = column <= 1
    points = np.column_stack([column, row]) + np.where(held[:, None], 0.0, off)
    return points, np.where(other, two, one).reshape(-1, 3).astype(np.int32), held


def cut(points: Float, faces: Int, held: Bool, material: Material, angle: float = 0.0) -> Fabric:
    """Points in cells, the warp at an angle to x [degrees]."""
    x = CELL * np.column_stack([points, np.zeros(len(points))])
    axes = yarn_axes(x[faces], np.array([np.cos(np.radians(angle)), np.sin(np.radians(angle)), 0.0]))
    share = np.repeat(face_areas(x[faces]) * material.density / 3, 3)
    mass = np.bincount(faces.reshape(-1), share, len(x)).astype(np.float64)
    bending = build_bending(material, x[faces], faces, *axes, held)
    return Fabric("cut", x, 0.0 * x, mass, held, faces, bending=bending)


def rigidity(material: Material, angle: float) -> float:
    """Of a narrow strip at this angle to the warp, per width [N m]."""
    c, s = np.cos(np.radians(angle)), np.sin(np.radians(angle))
    moment = np.array([c * c, s * s, -2.0 * c * s])
    return float(1.0 / (moment @ np.linalg.solve(plate(material), moment)))


def drop(fabric: Fabric) -> Float:
    """(n,) of a fabric under 1 m/s^2, so slightly that its slopes stay small."""
    free, found = ~fabric.pinned, np.zeros(fabric.number)
    found[free] = scipy.sparse.linalg.spsolve(matrix(fabric)[free][:, free], fabric.mass[free])
    return found


def expected_drop(x: Float, mass: Float, wide: int, stiffness: float, twist: float = np.inf) -> float:
    """Of the end of a beam that is as wide at each place as a ribbon along x (n, 2) and bears its masses there.

    Where its middle runs at an angle a to x, a moment M about y bends it by M cos a and twists it by M sin a, over a
    width of w cos a and a length of dx / cos a: M^2 / w (1 / stiffness + tan^2 a / twist) per dx, twist being 4 B_t.
    """
    place = np.linspace(CELL, x[:, 0].max(), 4000)
    low, high = (np.interp(place, *x[row :: wide + 1].T) for row in (0, wide))
    slope = np.gradient(0.5 * (low + high), place)
    moment = (mass * np.maximum(x[:, 0] - place[:, None], 0.0)).sum(axis=1)
    curvature = moment / (high - low) * (1.0 / stiffness + np.square(slope) / twist)
    return float(np.trapezoid(curvature * (place[-1] - place), place))


def highest(fabric: Fabric) -> float:
    """Square of the highest frequency of what is free [1/s^2]."""
    free, root = ~fabric.pinned, 1.0 / np.sqrt(fabric.mass)
    scaled = matrix(fabric).toarray() * root * root[:, None]
    return float(np.linalg.eigvalsh(scaled[free][:, free])[-1])


@pytest.mark.parametrize(("jitter", "across", "narrowest"), [
    (1e-9, True, 1), (1e-5, True, 1), (1e-3, True, 1), (1e-2, True, 1), (0.1, True, 1), (0.2, False, 1), (0.3, True, 2),
])  # fmt: skip
def test_a_ribbon_drops_as_its_rigidity_asks_for_wherever_its_vertices_are(
    jitter: float, across: bool, narrowest: int
) -> None:
    """One to eight cells wide, however cut: within 2 %, at a step that is as long as on a regular one, or a third."""
    for wide in range(narrowest, 9):
        for alternate in (False, True) if wide == 1 else (wide % 2 == 0,):
            points, faces, held = ribbon(wide, alternate, jitter, across)
            fabric = cut(points, faces, held, CLOTH)
            found = drop(fabric)[-wide - 1 :].mean()
            assert found == pytest.approx(expected_drop(fabric.position[:, :2], fabric.mass, wide, 5e-5), rel=0.02), (
                wide,
                alternate,
            )
            if wide <= 2:
                even = cut(*ribbon(wide, alternate, 0.0), CLOTH)
                assert highest(fabric) < (1.2 if jitter < 0.02 else 9.0) * highest(even)


@pytest.mark.parametrize("seeds", [
    range(100, 140), pytest.param((*range(140, 380), *range(1000, 1280)), marks=pytest.mark.full),
])  # fmt: skip
def test_ribbons_of_very_uneven_width_drop_so_too(seeds: Iterable[int]) -> None:
    """0.4 to 1.6 cells wide, and leaning to and fro: all 560 within 1 %."""
    for seed in seeds:
        fabric = cut(*ribbon(1, seed % 2 == 1, 0.3, True, seed), CLOTH)
        beam = expected_drop(fabric.position[:, :2], fabric.mass, 1, 5e-5, 4.0 * CLOTH.bend_twist)
        assert drop(fabric)[-2:].mean() == pytest.approx(beam, rel=0.01), seed


def test_a_moment_alike_all_along_bends_a_ribbon_as_a_beam() -> None:
    """A couple on the last four vertices, without torsion: heights are within 1 %, wherever vertices are."""
    for seed in range(20):
        points, faces, held = ribbon(1, seed % 2 == 1, 0.3, True, seed)
        fabric = cut(points, faces, held, CLOTH)
        x, free = fabric.position[:, :2], ~fabric.pinned
        force, found = np.zeros(len(x)), np.zeros(len(x))
        force[-4:] = np.linalg.pinv(np.column_stack([np.ones(4), x[-4:]]).T) @ [0.0, 1.0, 0.0]
        found[free] = scipy.sparse.linalg.spsolve(matrix(fabric)[free][:, free], force[free])
        place = np.linspace(CELL, x[-4:, 0].min(), 4000)
        low, high = (np.interp(place, *x[row::2].T) for row in (0, 1))
        twist = np.square(np.gradient(0.5 * (low + high), place)) / (4.0 * CLOTH.bend_twist)
        curvature = (1.0 / 5e-5 + twist) / (high - low)
        height = cumulative_trapezoid(cumulative_trapezoid(curvature, place, initial=0.0), place, initial=0.0)
        expected = np.interp(x[56:58, 0], place, height).mean()
        assert found[56:58].mean() == pytest.approx(expected, rel=0.01), seed


def scattered_borders(seed: int) -> tuple[Float, Int, Bool]:
    """A ribbon as wide as long cells, with 28 vertices anywhere on each border, joined after Delaunay."""
    rng, ends = np.random.default_rng(seed), [[x, y] for x in (0.0, 1.0, LONG) for y in (0.0, 1.0)]
    rows = [np.column_stack([np.sort(rng.uniform(1.1, LONG - 0.1, 28)), np.full(28, y)]) for y in (0.0, 1.0)]
    points = np.vstack([ends, *rows])
    return points, triangulate(points), points[:, 0] <= 1.0


def even_drop(fabric: Fabric, start: float = CELL) -> float:
    """Of the end of a beam one cell wide that is clamped up to `start`."""
    place = np.linspace(start, fabric.position[:, 0].max(), 4000)
    moment = (fabric.mass * np.maximum(fabric.position[:, 0] - place[:, None], 0.0)).sum(axis=1)
    return float(np.trapezoid(moment / (5e-5 * CELL) * (place[-1] - place), place))


@pytest.mark.parametrize("seeds", [range(20), pytest.param(range(20, 120), marks=pytest.mark.full)])
def test_a_ribbon_with_vertices_anywhere_on_its_borders_drops_so_too(seeds: range) -> None:
    """19 of 20 within 2 %, all within 10 %, with a step as long as on regular cells a quarter as long."""
    errors, least = [], highest(cut(*ribbon(1, True, 0.0), CLOTH)) * 4.0**4
    for seed in seeds:
        points, faces, held = scattered_borders(seed)
        fabric = cut(points, faces, held, CLOTH)
        errors.append(abs(drop(fabric)[points[:, 0] == LONG].mean() / even_drop(fabric) - 1.0))
        assert highest(fabric) < least, seed
    assert np.mean(np.array(errors) < 0.02) >= 0.95 and max(errors) < 0.1


@pytest.mark.parametrize("length", [0.25, 0.5, 2.0, 10.0])
def test_cells_of_a_ribbon_may_be_short_or_long(length: float) -> None:
    """Within 2 %, whichever way they are cut."""
    for alternate in (True, False):
        points, faces, held = ribbon(1, alternate, 0.0)
        fabric = cut(points * [length, 1.0], faces, held, CLOTH)
        assert drop(fabric)[-2:].mean() == pytest.approx(even_drop(fabric, length * CELL), rel=0.02)


def test_vertices_of_one_border_may_be_as_near_as_they_like() -> None:
    """The step is a third of that on regular cells at least, and the ribbon drops as far."""
    points, faces, held = ribbon(1, True, 0.0)
    one = next(k for k, face in enumerate(faces) if {32, 34} <= set(face))
    even = cut(points, faces, held, CLOTH)
    for near in (0.3, 0.1, 1e-2, 1e-4, 1e-6, 1e-8):
        more = np.vstack([points, points[32] + [near, 0.0]])
        two = [np.where(faces[one] == other, len(points), faces[one]) for other in (32, 34)]
        cloth = cut(more, np.vstack([np.delete(faces, one, 0), two]).astype(np.int32), np.append(held, False), CLOTH)
        assert highest(cloth) < 9.0 * highest(even)
        assert drop(cloth)[64:66].mean() == pytest.approx(even_drop(cloth), rel=0.01)


@pytest.mark.parametrize("wide", [1, 2, 4])
def test_a_ribbon_of_scattered_points_drops_so_too(wide: int) -> None:
    """Joined after Delaunay, slivers among them: within 4 %."""
    rng, edges = np.random.default_rng(wide), np.arange(wide + 1.0)
    rows = [np.column_stack([rng.uniform(1.1, LONG - 0.1, 28), np.full(28, y)]) for y in (0.0, wide)]
    ends = [np.column_stack([np.full(wide + 1, x), edges]) for x in (0.0, 1.0, LONG)]
    inside = np.column_stack([rng.uniform(1.1, LONG - 0.1, 32 * wide), rng.uniform(0.02, wide - 0.02, 32 * wide)])
    points = np.vstack([*ends, *rows, inside])
    faces = triangulate(points)
    faces = faces[face_areas(np.column_stack([points, 0.0 * points[:, 0]])[faces]) > 1e-12]
    fabric = cut(points, faces, points[:, 0] <= 1.0, CLOTH)
    place = CELL * np.linspace(1.0, LONG, 4000)
    moment = (fabric.mass * np.maximum(fabric.position[:, 0] - place[:, None], 0.0)).sum(axis=1)
    expected = np.trapezoid(moment / (5e-5 * wide * CELL) * (place[-1] - place), place)
    assert drop(fabric)[points[:, 0] == LONG].mean() == pytest.approx(expected, rel=0.04)


@pytest.mark.parametrize("material", [CLOTH, CURLS])
@pytest.mark.parametrize("angle", [0.0, 30.0, 45.0, 90.0])
def test_a_ribbon_one_cell_wide_is_a_narrow_strip_along_any_direction(material: Material, angle: float) -> None:
    """It is free to curl up across: 1 - nu^2 of the rigidity with the width held."""
    for jitter in (0.0, 1e-6, 1e-3, 0.05):
        points, faces, held = ribbon(1, True, jitter)
        fabric = cut(points, faces, held, material, angle)
        expected = expected_drop(fabric.position[:, :2], fabric.mass, 1, rigidity(material, angle))
        assert drop(fabric)[-2:].mean() == pytest.approx(expected, rel=0.01)


def test_bending_goes_on_steadily_as_a_curvature_fades() -> None:
    """No threshold is felt: a move of 1e-6 of a cell changes the matrix by as little, however far off two lines."""
    points, faces, held = ribbon(1, True, 0.3)
    flat = np.round(points)
    for off in np.linspace(0.0, 1.0, 40):
        near, far = (cut(flat + k * (points - flat), faces, held, CLOTH) for k in (off, off + 1e-6))
        change = np.abs((matrix(near) - matrix(far)).toarray()).max()
        assert change < 1e-3 * np.abs(matrix(near).toarray()).max()


def test_pieces_that_share_a_vertex_turn_freely_about_it() -> None:
    """So do triangles alone: what is flat in each piece costs nothing, and nothing makes a step short."""
    bow = np.array([[0.0, 0.0], [1.0, 0.2], [1.0, -0.2], [-1.0, 0.2], [-1.0, -0.2]])
    apart = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [3.0, 0.0], [4.0, 0.0], [3.0, 1.0]])
    for points, faces in ((bow, [[0, 2, 1], [0, 3, 4]]), (apart, [[0, 1, 2], [3, 4, 5]])):
        fabric = cut(points, np.array(faces, np.int32), np.zeros(len(points), bool), CLOTH, 20.0)
        assert np.abs(matrix(fabric).toarray()).max() < 1e-12 * 5e-5 / CELL**2


@pytest.mark.parametrize("weft", [0.0, 1e-9])
def test_cloth_that_hardly_bends_along_one_yarn_has_a_bounded_step(weft: float) -> None:
    for jitter in (0.0, 1e-6, 1e-2, 0.3):
        points, faces, held = ribbon(1, True, jitter)
        fabric = cut(points, faces, held, replace(CLOTH, bend_weft=weft), 20.0)
        assert highest(fabric) < 10.0 * highest(cut(*ribbon(1, True, 0.0), CLOTH))


def test_a_vertex_that_comes_near_another_or_an_edge_keeps_the_step() -> None:
    """Slivers of any height among larger triangles: at most ten times the square of the frequency."""
    points, faces, held = ribbon(4, False, 0.0)
    one = next(k for k, face in enumerate(faces) if set(face) == {82, 83, 87})  # of the ribbon's middle
    even = highest(cut(points, faces, held, CLOTH))
    for height in (0.1, 1e-2, 1e-3, 1e-5, 1e-8):
        edge = points[[83, 87]].mean(axis=0)
        more = np.vstack([points, edge + height * (points[82] - edge)])
        around = [[82, 87, 165], [87, 83, 165], [83, 82, 165]]
        cloth = cut(more, np.vstack([np.delete(faces, one, 0), around]).astype(np.int32), np.append(held, False), CLOTH)
        assert highest(cloth) < 10.0 * even


def test_friction_of_a_ribbon_is_bounded_too() -> None:
    """What a change of curvature holds, at most five times as much as on a ribbon two cells wide."""
    rubs = replace(CLOTH, hysteresis_warp=1e-3, hysteresis_weft=1e-3)
    sizes = []
    for wide, jitter in ((2, 0.0), (1, 0.0), (1, 1e-6), (1, 1e-4), (1, 1e-2), (1, 0.1), (1, 0.3)):
        points, faces, held = ribbon(wide, True, jitter)
        x = CELL * np.column_stack([points, np.zeros(len(points))])
        friction = build_friction(rubs, x[faces], faces, *yarn_axes(x[faces], np.array([0.8, 0.6, 0.0])), held)
        assert friction is not None
        sizes.append(np.abs(friction.shares).max())
    assert max(sizes) < 5.0 * sizes[0]


def test_files_of_a_ribbon_and_of_a_bow_bend_as_they_are_drawn(shared_data: Path) -> None:
    """Written with 3 to 15 decimals of a metre a ribbon is as stiff, and its step as long."""
    cases = shared_data / "cases"
    fabric = {"density": 0.05, "warp": 400, "weft": 400, "shear": 30, "bend_warp": 5e-5, "bend_weft": 5e-5}
    found = {}
    for decimals in (15, 8, 7, 6, 5, 4, 3):
        config = {"file": f"ribbon-{decimals}.obj", "warp": (0.8660254, 0.5, 0), "pin": (0, 1, 2, 3), "fabric": fabric}
        files = SceneFiles(cases / "32-strip-one-cell-wide")
        built = Mesh().build(MeshConfig.model_validate(config), files, 0)
        along = built.position[:, :2] @ np.array([[3**0.5, -1.0], [1.0, 3**0.5]]) / 2.0
        found[decimals] = highest(built)
        assert drop(built)[-2:].mean() == pytest.approx(expected_drop(along, built.mass, 1, 5e-5), rel=0.02)
        assert found[decimals] == pytest.approx(found[15], rel=0.01 if decimals > 3 else 0.3)
    config = {"file": "deg-bowtie.obj", "fabric": "denim"}
    bow = Mesh().build(MeshConfig.model_validate(config), SceneFiles(cases / "31-bowtie-hang"), 0)
    assert highest(bow) < 1.0


def plate_drop(fabric: Fabric, material: Material, wide: int = 1) -> float:
    """Of the end of a ribbon along x, an isotropic plate of Morley's triangles (1968, Aeronaut. Q. 19, 149-169), each
    cut into 16 and into 64, and by the two as if there were no end to cutting.
    """
    x, faces, found = fabric.position[:, :2], fabric.faces, []
    for cuts in range(4):
        edges, of_face = np.unique(np.sort(np.vstack([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])), axis=0,
                                   return_inverse=True)  # fmt: skip
        sides, middle = len(x) + of_face.reshape(3, -1).T, x[edges].mean(axis=1)
        if cuts >= 2:
            found.append(
                _morley(x, faces, edges, sides, plate(material), fabric.mass)[: fabric.number][-wide - 1 :].mean()
            )
        a, b, c = sides.T
        around = [np.stack([faces[:, k], sides[:, k], sides[:, k - 1]], axis=1) for k in range(3)]
        x, faces = np.vstack([x, middle]), np.vstack([*around, np.stack([a, b, c], axis=1)])
    return float(found[1] + (found[1] - found[0]) / 3.0)


def _morley(x: Float, faces: Int, edges: Int, sides: Int, rigidity: Float, force: Float) -> Float:
    """Heights of vertices and slopes across edges of quadratic functions in triangles, clamped up to CELL."""
    along, middle = x[edges[:, 1]] - x[edges[:, 0]], x[edges].mean(axis=1)
    across = np.stack([-along[:, 1], along[:, 0]], axis=1) / np.linalg.norm(along, axis=1)[:, None]
    u, v = np.moveaxis(x[faces] - x[faces].mean(axis=1, keepdims=True), 2, 0)
    heights = np.stack([np.ones_like(u), u, v, 0.5 * u * u, 0.5 * v * v, u * v], axis=2)
    u, v = np.moveaxis(middle[sides - len(x)] - x[faces].mean(axis=1, keepdims=True), 2, 0)
    n, zero = across[sides - len(x)], np.zeros_like(u)
    slopes = np.stack([zero, n[..., 0], n[..., 1], n[..., 0] * u, n[..., 1] * v, n[..., 0] * v + n[..., 1] * u], axis=2)
    second = np.linalg.inv(np.concatenate([heights, slopes], axis=1))[:, 3:]
    area = face_areas(np.concatenate([x[faces], 0.0 * x[faces][..., :1]], axis=2))
    each = np.einsum("fai,ab,fbj->fij", second, rigidity, second) * area[:, None, None]
    unknown = np.concatenate([faces, sides], axis=1)
    pairs = np.repeat(unknown, 6, axis=1).reshape(-1), np.tile(unknown, (1, 6)).reshape(-1)
    size = len(x) + len(edges)
    free = np.concatenate([x[:, 0], middle[:, 0]]) > CELL * (1.0 + 1e-9)
    stiffness = scipy.sparse.coo_matrix((each.reshape(-1), pairs), (size, size)).tocsc()[free][:, free]
    found, load = np.zeros(size), np.zeros(size)
    load[: len(force)] = force
    found[free] = scipy.sparse.linalg.spsolve(stiffness, load[free])
    return found


@pytest.mark.parametrize(("seeds", "jitter"), [
    (5, 0.2), (5, 0.3),
    pytest.param(40, 0.1, marks=pytest.mark.full), pytest.param(40, 0.2, marks=pytest.mark.full),
    pytest.param(40, 0.3, marks=pytest.mark.full),
])  # fmt: skip
def test_a_ribbon_one_cell_wide_drops_so_with_any_border(seeds: int, jitter: float) -> None:
    """Within 2 %, curled or not, whichever way it is cut; of borders that make it 0.4 to 1.6 wide 19 of 20 ribbons, and
    all within 3.5 %.
    """
    off = []
    for seed in range(seeds):
        for across in (True, False):
            for material, angle, alternate in ((CLOTH, 0.0, seed % 2 == 0), (CURLS, 30.0, seed % 2 == 1)):
                fabric = cut(*ribbon(1, alternate, jitter, across, seed), material, angle)
                stiffness, twist = rigidity(material, angle), plate(material)[2, 2]
                expected = expected_drop(fabric.position[:, :2], fabric.mass, 1, stiffness, twist)
                off.append(abs(drop(fabric)[-2:].mean() / expected - 1.0))
    assert max(off) < (0.035 if jitter > 0.2 else 0.02)
    assert np.mean(np.array(off) < 0.02) >= 0.95


def test_slivers_of_flat_pieces_are_flipped_and_no_others() -> None:
    """The pieces stay as large, no side lies between wide angles, and regular cells keep theirs whatever is rounded."""
    rng = np.random.default_rng(3)
    for jitter in (0.0, 1e-9, 1e-3, 0.35):
        points, faces, _ = ribbon(6, True, jitter, True, 7)
        corners = np.column_stack([points, np.zeros(len(points))])[faces]
        piece = (corners[:, :, 0].mean(axis=1) > 16.0).astype(np.int32)
        sides = flip_slivers(corners, faces, piece[:, None])
        found, flipped = sides.corners, sides.faces
        assert (jitter > 0.1) == bool((flipped != faces).any())
        assert np.array_equal(np.column_stack([points, np.zeros(len(points))])[flipped], found)
        for one in (0, 1):
            assert face_areas(found)[piece == one].sum() == pytest.approx(face_areas(corners)[piece == one].sum())
        assert np.array_equal(flip_slivers(found, flipped, piece[:, None]).faces, flipped)
    bent = np.column_stack([points, 0.2 * rng.uniform(size=len(points))])[faces]
    assert np.array_equal(flip_slivers(bent, faces, piece[:, None]).faces, faces)
    turned_over = np.array([[0.0, 0.0, 0.0], [4.0, 0.0, 0.0], [2.0, 0.2, 0.0], [2.0, 0.1, 0.0]])
    pair = np.array([[0, 1, 2], [1, 0, 3]], np.int32)
    assert np.array_equal(flip_slivers(turned_over[pair], pair, np.zeros((2, 1))).faces, pair)


@pytest.mark.full
@pytest.mark.parametrize("wide", [2, 3, 4, 6, 8])
def test_wider_ribbons_of_very_uneven_cells_drop_so_too(wide: int) -> None:
    """Off by 0.3 of a cell, slivers in line across some: 49 of 50 are within 2 % of the beam, and the others of a
    plate. One in two hundred has triangles that are turned over, and is no mesh.
    """
    others = 0
    for seed in range(200):
        points, faces, held = ribbon(wide, seed % 2 == 1, 0.3, True, seed)
        one, two = (points[faces[:, k]] - points[faces[:, 0]] for k in (1, 2))
        if (one[:, 0] * two[:, 1] - one[:, 1] * two[:, 0]).min() <= 0.0:
            continue
        fabric = cut(points, faces, held, CLOTH)
        found = drop(fabric)[-wide - 1 :].mean()
        if found != pytest.approx(expected_drop(fabric.position[:, :2], fabric.mass, wide, 5e-5), rel=0.02):
            others += 1
            assert found == pytest.approx(plate_drop(fabric, CLOTH, wide), rel=0.02), seed
    assert others <= 4


@pytest.mark.parametrize(
    "wave", [0.5, pytest.param(0.3, marks=pytest.mark.full), pytest.param(0.7, marks=pytest.mark.full)]
)
def test_a_ribbon_that_runs_to_and_fro_twists_as_it_bends(wave: float) -> None:
    """Alike wide all along: within 3 % of a plate, which is 3, 7 and 14 % softer than a straight one."""
    points, faces, held = ribbon(1, True, 0.0)
    points[:, 1] += np.where(points[:, 0] % 2 == 0.0, wave, 0.0) * ~held
    fabric = cut(points, faces, held, CLOTH)
    assert drop(fabric)[-2:].mean() == pytest.approx(plate_drop(fabric, CLOTH), rel=0.03)


@pytest.mark.parametrize("swing", [0.8, pytest.param(1.2, marks=pytest.mark.full)])
def test_a_ribbon_that_meanders_drops_as_a_plate(swing: float) -> None:
    """Its middle turns by `swing` to either side, with a radius of 2.4 and 1.6 cells: within 2 %."""
    along = np.linspace(0.0, LONG, 6401)
    turn = np.where(along > 4.0, swing * np.sin((along - 4.0) * np.pi / 6.0), 0.0)
    middle = [cumulative_trapezoid(part, along, initial=0.0) for part in (np.cos(turn), np.sin(turn))]
    for alternate in (True, False):
        points, faces, held = ribbon(1, alternate, 0.1, True, 3)
        x, y, angle = (np.interp(points[:, 0], along, part) for part in (*middle, turn))
        off = points[:, 1] - 0.5
        fabric = cut(np.column_stack([x - off * np.sin(angle), y + off * np.cos(angle)]), faces, held, CLOTH)
        assert drop(fabric)[-2:].mean() == pytest.approx(plate_drop(fabric, CLOTH), rel=0.02)


@pytest.mark.full
@pytest.mark.parametrize("material", [CLOTH, CURLS])
def test_what_is_expected_of_ribbons_is_what_plates_do(material: Material) -> None:
    """Within 1.5 %, and cloth within 2.5 % of a plate."""
    for seed in range(10):
        fabric = cut(*ribbon(1, seed % 2 == 0, 0.3, True, seed), material)
        stiffness, twist = rigidity(material, 0.0), plate(material)[2, 2]
        exact = plate_drop(fabric, material)
        expected = expected_drop(fabric.position[:, :2], fabric.mass, 1, stiffness, twist)
        assert expected == pytest.approx(exact, rel=0.015)
        assert drop(fabric)[-2:].mean() == pytest.approx(exact, rel=0.025)
