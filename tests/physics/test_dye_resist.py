"""What keeps dye out or is dyed before weaving: images, lines and patterns, folded packets, ikat."""

from __future__ import annotations

import math
import struct
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from dye_runs import SOLVERS
from pattern_files import SIZE, Folder, write_image
from pydantic import TypeAdapter, ValidationError

from nuno_dye.cloths.woven_cloth import Ikat, WovenCloth, WovenClothConfig
from nuno_dye.laws.isotherms import Langmuir
from nuno_dye.supplies.regions import Disc, Polygon, Rectangle, Stroke, contains, cover
from nuno_dye.supplies.resist import (
    Binding,
    Folded,
    ImageResist,
    Paste,
    Resist,
    ShapeResist,
    Shibori,
    combine,
    find_resist,
    find_resists,
    read_image,
    stretch,
)
from nuno_dye.supplies.shibori import Rings, Seigaiha, Squares, Stripes, draw_pattern, fold, fold_cells
from nuno_schemas.dye import Cells, Dye, DyeState, DyeSystem
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Float


def png(path: Path, values: np.ndarray, depth: int, kind: int, clear: int | None = None) -> Path:
    """A PNG (RFC 2083) of integers (ny, nx, channels), packed by hand; the grey value `clear` is transparent."""

    def chunk(name: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))

    ny, nx, _ = values.shape
    rows = b""
    for row in values.reshape(ny, -1):
        bits = "".join(format(int(value), f"0{depth}b") for value in row)
        bits += "0" * (-len(bits) % 8)
        rows += b"\0" + bytes(int(bits[i : i + 8], 2) for i in range(0, len(bits), 8))
    header = struct.pack(">IIBBBBB", nx, ny, depth, kind, 0, 0, 0)
    transparent = b"" if clear is None else chunk(b"tRNS", struct.pack(">H", clear))
    body = chunk(b"IHDR", header) + transparent + chunk(b"IDAT", zlib.compress(rows)) + chunk(b"IEND", b"")
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + body)
    return path


def test_an_oblique_edge_of_paste_bleeds_as_it_diffuses(tmp_path: Path) -> None:
    """1/2 erfc(x / (sqrt 2 s)) over an edge of any direction, without the stairs of cells, and as much paste as before.

    Middles of cells lie on lines sqrt(1/2) apart at 45 degrees: an edge is off by half of that at most, which is 0.071
    of the profile's height where it is steepest.
    """
    size, spread = 1e-3, 2e-3
    y, x = (np.mgrid[0:80, 0:80] + 0.5) * size
    for angle in (0.0, 0.3, math.pi / 4.0):
        across = (x - 0.04) * math.cos(angle) + (y - 0.04) * math.sin(angle)
        far = [
            (0.04 + 0.5 * math.cos(angle + turn), 0.04 + 0.5 * math.sin(angle + turn))
            for turn in (1.0, 0.5, -0.5, -1.0)
        ]
        along = [(0.04 + way * math.sin(angle), 0.04 - way * math.cos(angle)) for way in (0.5, -0.5)]
        region = Polygon(points=(along[1], *far, along[0]))
        sharp, bled = (
            find_resist(ShapeResist(region=region, bleed=bleed), (80, 80), size, Folder(tmp_path))
            for bleed in (0.0, spread)
        )
        exact = 0.5 * np.vectorize(math.erfc)(-across / (math.sqrt(2.0) * spread))
        inner = (slice(16, -16),) * 2
        assert np.abs(bled - exact)[inner].max() < 0.072 < 0.3 < np.abs(sharp - exact)[inner].max()
        assert bled.sum() == pytest.approx(sharp.sum(), rel=1e-3)


def test_a_bleed_wider_than_the_cloth_is_refused(tmp_path: Path) -> None:
    def paste(bleed: float) -> Paste:
        return Paste(points=((0.0, 1e-3), (4e-3, 1e-3)), width=1e-3, bleed=bleed)

    find_resists([paste(2e-3)], (20, 40), 1e-4, Folder(tmp_path))
    with pytest.raises(BadInput, match="farther than the cloth") as refused:
        find_resists([paste(0.0), paste(2.1e-3)], (20, 40), 1e-4, Folder(tmp_path))
    assert refused.value.field == "resist[1].bleed" and "0.002 m" in str(refused.value.limit)


@pytest.mark.parametrize("depth", [1, 2, 4, 8, 16])
def test_grey_of_every_depth_is_a_share_of_its_white(tmp_path: Path, depth: int) -> None:
    most = 2**depth - 1
    values = np.random.default_rng(depth).integers(0, most + 1, (7, 11, 1))
    values[0, :2, 0] = 0, most
    found = read_image(png(tmp_path / "a.png", values, depth, 0), (7, 11))
    assert found.shape == (7, 11) and np.abs(found - values[..., 0] / most).max() < 1e-15
    inverse = read_image(tmp_path / "a.png", (7, 11), invert=True)
    assert np.abs(inverse + found - 1.0).max() < 1e-15


@pytest.mark.parametrize("kind", [2, 4, 6])
def test_grey_in_colour_channels_and_transparency(tmp_path: Path, kind: int) -> None:
    rng = np.random.default_rng(kind)
    grey, opacity = rng.integers(0, 256, (5, 6, 1)), rng.integers(0, 256, (5, 6, 1))
    channels = np.tile(grey, 3) if kind != 4 else grey
    values = channels if kind == 2 else np.concatenate([channels, opacity], axis=2)
    share = grey[..., 0] / 255 * (1.0 if kind == 2 else opacity[..., 0] / 255)
    assert np.abs(read_image(png(tmp_path / "a.png", values, 8, kind), (5, 6)) - share).max() < 1e-15


@pytest.mark.parametrize("kind", [2, 4, 6])
def test_several_channels_of_16_bits_are_read_to_8(tmp_path: Path, kind: int) -> None:
    """Against white and full opacity, never against the most that the image holds."""
    rng = np.random.default_rng(kind)
    grey, opacity = rng.integers(0, 30_000, (5, 6, 1)), rng.integers(0, 30_000, (5, 6, 1))
    channels = np.tile(grey, 3) if kind != 4 else grey
    values = channels if kind == 2 else np.concatenate([channels, opacity], axis=2)
    share = grey[..., 0] / 65535 * (1.0 if kind == 2 else opacity[..., 0] / 65535)
    assert np.abs(read_image(png(tmp_path / "a.png", values, 16, kind), (5, 6)) - share).max() < 1 / 255


@pytest.mark.parametrize("depth", [1, 8, 16])
def test_a_grey_value_that_is_transparent_keeps_nothing_out(tmp_path: Path, depth: int) -> None:
    most = 2**depth - 1
    values = np.array([[[0], [most], [most // 2], [most]]])
    found = read_image(png(tmp_path / "a.png", values, depth, 0, clear=most), (1, 4))
    assert found[0].tolist() == [0.0, 0.0, most // 2 / most, 0.0]
    inverse = read_image(tmp_path / "a.png", (1, 4), invert=True)
    assert inverse[0].tolist() == [1.0, 0.0, 1.0 - most // 2 / most, 0.0]


def test_images_that_cannot_be_used_are_refused_with_both_sizes(tmp_path: Path) -> None:
    path = png(tmp_path / "a.png", np.zeros((5, 6, 1), int), 8, 0)
    with pytest.raises(BadInput, match=r"(?s)a\.png.*6 x 5 pixels.*8 x 7 cells"):
        read_image(path, (7, 8))
    colour = png(tmp_path / "c.png", np.arange(90).reshape(5, 6, 3), 8, 2)
    with pytest.raises(BadInput, match="in colour"):
        read_image(colour, (5, 6))
    whole = path.read_bytes()
    for data in (b"", b"GIF89a", whole[:20], whole[:45], whole[:-20], whole.replace(b"IDAT", b"IDOT")):
        path.write_bytes(data)
        with pytest.raises(BadInput, match="cannot be read as PNG") as refused:
            read_image(path, (5, 6))
        assert "_io." not in str(refused.value)
    # A size that no computer can hold is refused by its header.
    huge = png(tmp_path / "h.png", np.zeros((1, 1, 1), int), 8, 0)
    data = huge.read_bytes()
    header = struct.pack(">IIBBBBB", 2**30, 2**30, 8, 0, 0, 0, 0)
    huge.write_bytes(data[:16] + header + struct.pack(">I", zlib.crc32(b"IHDR" + header)) + data[33:])
    with pytest.raises(BadInput):
        read_image(huge, (5, 6))


def test_what_is_written_is_read_again(tmp_path: Path) -> None:
    values = np.random.default_rng(1).random((9, 8))
    write_image(tmp_path / "a.png", values)
    assert np.abs(read_image(tmp_path / "a.png", (9, 8)) - values).max() <= 2**-17


def test_a_stencil_of_any_size_is_drawn_out_over_the_cloth(tmp_path: Path) -> None:
    """Its mean stays; cells that several pixels fall into hold their mean; between pixels' middles finer cells go
    linearly.
    """
    values = np.random.default_rng(1).random((40, 60))
    write_image(tmp_path / "a.png", values)
    item = ImageResist(file="a.png", fit="stretch")
    small = find_resist(item, (20, 20), SIZE, Folder(tmp_path))
    assert np.abs(small - values.reshape(20, 2, 20, 3).mean(axis=(1, 3))).max() < 2e-5
    odd = find_resist(item, (33, 37), SIZE, Folder(tmp_path))
    assert odd.mean() == pytest.approx(values.mean(), abs=1e-5)
    across = find_resist(item, (40, 240), SIZE, Folder(tmp_path))
    assert across.mean() == pytest.approx(values.mean(), abs=1e-5)
    for k in range(4):
        share = (k + 0.5) / 4.0
        assert np.abs(across[:, 2 + k : -2 : 4] - (1 - share) * values[:, :-1] - share * values[:, 1:]).max() < 2e-5
    down = find_resist(item, (160, 60), SIZE, Folder(tmp_path))
    assert np.abs(down[2:-2:4] - 0.875 * values[:-1] - 0.125 * values[1:]).max() < 2e-5
    with pytest.raises(BadInput, match="60 x 40 pixels"):
        find_resist(ImageResist(file="a.png"), (20, 20), SIZE, Folder(tmp_path))


def test_items_of_a_scene(tmp_path: Path) -> None:
    values = np.random.default_rng(1).random((20, 30))
    write_image(tmp_path / "stencil.png", values)
    files, shape = Folder(tmp_path), (20, 30)
    image = find_resist(ImageResist(file="stencil.png", strength=0.5), shape, SIZE, files)
    assert np.abs(image - 0.5 * values).max() <= 2**-18
    item = {"kind": "shape", "region": {"shape": "rectangle", "low": [0, 0], "high": ["1 mm", "2 mm"]}, "strength": 0.7}
    part = find_resist(TypeAdapter(Resist).validate_python(item), shape, SIZE, files)
    assert (part[:, :10] == 0.7).all() and not part[:, 10:].any()
    both = combine([image, part])
    assert np.allclose(1.0 - both, (1.0 - image) * (1.0 - part), rtol=1e-15)
    assert (combine([image, np.ones(shape)]) == 1.0).all() and np.array_equal(combine([0 * image]), 0 * image)


def test_paste_is_even_and_a_binding_presses_as_hertz_says(tmp_path: Path) -> None:
    points, width = ((0.0, 2e-3), (6e-3, 2e-3)), 2e-3
    paste = find_resist(Paste(points=points, width=width), (40, 60), SIZE, Folder(tmp_path))
    binding = find_resist(Binding(points=points, width=width, strength=0.9), (40, 60), SIZE, Folder(tmp_path))
    middle = (np.arange(40) + 0.5) * SIZE - 2e-3
    assert np.array_equal(paste[:, 5], (np.abs(middle) <= 1e-3).astype(float))
    exact = 0.9 * np.sqrt(np.maximum(0.0, 1.0 - (middle / 1e-3) ** 2))
    assert np.abs(binding - exact[:, None]).max() < 1e-12
    # The force of a length is pi / 4 of what the full strength over the whole width would be.
    assert binding[:, 5].sum() * SIZE == pytest.approx(0.9 * width * math.pi / 4, rel=0.01)


@pytest.mark.parametrize("panels", [1, 2, 5])
def test_folding_mirrors_every_panel_in_the_next_one(panels: int) -> None:
    n = 20 * panels
    x = (np.arange(n) + 0.5) * SIZE
    folded = fold(x, n * SIZE, panels).reshape(panels, 20)
    for k in range(panels):
        assert np.allclose(folded[k], x[:20] if k % 2 == 0 else x[:20][::-1], atol=1e-15)
    pattern = Stripes(spacing=7e-4, width=3e-4, angle=0.4)
    image = draw_pattern(pattern, (panels, 1), (30, n), SIZE)
    first = image[:, :20]
    for k in range(panels):
        assert np.array_equal(image[:, 20 * k : 20 * k + 20], first if k % 2 == 0 else first[:, ::-1])
    assert 0.0 < first.mean() < 1.0


def share_of(image: Float) -> float:
    assert set(np.unique(image)) == {0.0, 1.0}
    return float(image.mean())


def test_patterns_cover_the_share_that_they_should() -> None:
    shape = (400, 400)
    stripes = draw_pattern(Stripes(spacing=2e-3, width=4e-4), (1, 1), shape, SIZE)
    assert share_of(stripes) == pytest.approx(0.2, rel=1e-12)
    turned = draw_pattern(Stripes(spacing=2e-3, width=5e-4, angle=0.7), (1, 1), shape, SIZE)
    assert share_of(turned) == pytest.approx(0.25, rel=0.02)
    squares = draw_pattern(Squares(side=4e-3), (4, 5), shape, SIZE)
    assert share_of(squares) == pytest.approx(20 * 16e-6 / 1.6e-3, rel=1e-12)
    assert share_of(draw_pattern(Squares(side=4e-3, angle=0.5), (4, 5), shape, SIZE)) == pytest.approx(0.2, rel=0.02)
    rings = draw_pattern(Rings(spacing=4e-3, width=1e-3), (1, 1), shape, SIZE)
    exact = sum(math.pi * ((r + 5e-4) ** 2 - (r - 5e-4) ** 2) for r in (2e-3, 6e-3, 1e-2, 1.4e-2, 1.8e-2))
    inside = np.hypot(*(np.indices(shape) + 0.5 - 200)) < 200
    assert (rings * inside).sum() * SIZE**2 == pytest.approx(exact, rel=0.02)
    for turn in (rings.T, rings[::-1], rings[:, ::-1]):
        assert np.array_equal(turn, rings)


def test_waves_repeat_lie_in_front_of_each_other_and_have_their_arcs() -> None:
    """Scales of radius r: repeat by 2 r along, by r down; half a repeat of both gives the same picture."""
    r = 40
    image = draw_pattern(Seigaiha(radius=r * SIZE, arcs=3), (1, 1), (8 * r, 8 * r), SIZE)
    assert 0.3 < share_of(image) < 0.6
    assert np.array_equal(image[:, 2 * r :], image[:, : -2 * r])
    assert np.array_equal(image[r:], image[:-r])
    assert np.array_equal(image[r // 2 :, r:], image[: -r // 2, :-r])
    # Up from a scale's middle one meets all of its arcs: 7 bands, of which 3 keep dye out.
    column = image[4 * r - 1 : 3 * r - 1 : -1, 4 * r]
    assert (np.diff(column) != 0).sum() == 6 and column.mean() == pytest.approx(3 / 7, abs=0.05)
    assert np.array_equal(image, image[:, ::-1])


@pytest.mark.parametrize(
    ("item", "said"),
    [
        ({"kind": "image"}, "file"),
        ({"kind": "wax"}, "wax"),
        ({"kind": "paste", "points": [[0, 0]], "width": "1 mm", "strength": 1.2}, "less than or equal to 1"),
        ({"kind": "shibori", "pattern": {"pattern": "rings", "spacing": 1, "width": 1, "turns": 3}}, "turns"),
        (
            {"kind": "shibori", "pattern": {"pattern": "squares", "side": 1}, "fold": [0, 1]},
            "greater than or equal to 1",
        ),
    ],
)
def test_what_is_no_resist_is_refused(item: dict[str, object], said: str) -> None:
    with pytest.raises(ValidationError, match=said):
        TypeAdapter(Resist).validate_python(item)


def test_bindings_without_room_between_are_refused(tmp_path: Path) -> None:
    for pattern in (Rings(spacing=1e-3, width=1e-3), Stripes(spacing=1e-3, width=2e-3)):
        with pytest.raises(BadInput, match=r"(?s)width.*below the spacing"):
            find_resist(Shibori(pattern=pattern), (10, 10), SIZE, Folder(tmp_path))
    with pytest.raises(BadInput, match="holds no cell"):
        find_resist(Paste(points=((1.0, 1.0),), width=1e-3), (10, 10), SIZE, Folder(tmp_path))
    region = {"shape": "disc", "centre": (1.0, 1.0), "diameter": 1e-3}
    with pytest.raises(BadInput, match="holds no cell"):
        find_resist(ShapeResist.model_validate({"region": region}), (10, 10), SIZE, Folder(tmp_path))


def draw_disc(n: int, centre: tuple[float, float], radius: float, finer: int = 32) -> Float:
    """(n, n) the share of each pixel of a unit square that lies in a disc, as drawing programs smooth an edge."""
    y, x = (np.mgrid[0 : n * finer, 0 : n * finer] + 0.5) / (n * finer)
    inside = np.hypot(x - centre[0], y - centre[1]) <= radius
    return np.asarray(inside.reshape(n, finer, n, finer).mean(axis=(1, 3)))


@pytest.mark.parametrize("cells", [(10, 13), (32, 33), (41, 96), (300, 288)])
def test_a_stencil_of_a_disc_covers_its_area_in_cells_of_any_size(cells: tuple[int, int]) -> None:
    """As much as its pixels do, to rounding: pi r^2 but for the points that the test counts a pixel's share by."""
    for k in range(8):
        centre, radius = (0.5 + 0.003 * k, 0.49 - 0.004 * k), 0.31 + 0.007 * k
        image = draw_disc(32, centre, radius)
        covered = stretch(image, cells)
        assert covered.mean() == pytest.approx(image.mean(), rel=1e-13)
        assert covered.mean() == pytest.approx(math.pi * radius**2, rel=1e-4)
        assert covered.min() == 0.0 and covered.max() == pytest.approx(1.0, abs=1e-12)


@pytest.mark.parametrize("n", [8, 32, 64])
def test_the_edge_of_a_stencil_has_no_stairs_in_cells_finer_than_its_pixels(n: int) -> None:
    """Where B passes a half is within a tenth of a pixel, and half a cell's diagonal, of the circle; stairs are off by
    more than half a pixel. An image with a pixel for each cell is left as it is.
    """
    centre, radius, times = (0.503, 0.488), 0.37, 16
    image = draw_disc(n, centre, radius)
    assert np.array_equal(stretch(image, (n, n)), image)
    y, x = (np.mgrid[0 : times * n, 0 : times * n] + 0.5) / (times * n)
    beyond = np.hypot(x - centre[0], y - centre[1]) - radius
    smooth, stairs = (
        max(beyond[found >= 0.5].max(), -beyond[found < 0.5].min())
        for found in (stretch(image, (times * n, times * n)), np.kron(image, np.ones((times, times))))
    )
    assert smooth * n < 0.1 + math.sqrt(0.5) / times and stairs * n > 0.5


SHAPE = 96, 120
"""Cells: 9.6 mm down, 12 mm across."""
BLOT = {"shape": "polygon", "points": [[0.0003, 0.0004], [0.0014, 0.0007], [0.0011, 0.0019]]}
SIDE, HEIGHT = 0.0041, 0.0041 * math.sqrt(0.75)


def draw(root: Path, *folds: dict[str, Any], **pressed: Any) -> Float:
    item = Folded.model_validate({"folds": folds, **(pressed or {"clamps": [BLOT]})})
    return find_resist(item, SHAPE, SIZE, Folder(root))


def test_pleats_of_whole_cells_mirror_the_resist_to_the_last_bit(tmp_path: Path) -> None:
    """At every fold of both directions, and the first panel is the packet."""
    across, down = {"fold": "pleats", "number": 6}, {"fold": "pleats", "width": 0.0024, "angle": math.pi / 2}
    alone = cover(Polygon.model_validate(BLOT), SHAPE, SIZE)
    for folds in ((across,), (across, down), (down, across)):
        found = draw(tmp_path, *folds)
        panels = found.reshape(96, 6, 20)
        assert np.array_equal(panels[:, 0], alone[:, :20]) or len(folds) == 2
        assert (panels[:, ::2] == panels[:, :1]).all() and (panels[:, 1::2] == panels[:, :1, ::-1]).all()
        if len(folds) == 2:
            rows = found.reshape(4, 24, 120)
            assert (rows[::2] == rows[:1]).all() and (rows[1::2] == rows[:1, ::-1]).all()
            assert np.array_equal(rows[0, :, :20], alone[:24, :20])


def mirrors(kind: str) -> list[tuple[Float, float]]:
    """Fold lines as (normal, distance of the line from the corner along it)."""
    oblique = np.array([math.cos(0.4), math.sin(0.4)])
    if kind == "pleats":
        return [(oblique, k * SIDE) for k in (1, 2, 3)]
    if kind == "right":
        slopes = [np.array([1.0, s]) / math.sqrt(2.0) for s in (1.0, -1.0)]
        return [(np.eye(2)[0], SIDE), (np.eye(2)[1], 2 * SIDE), (slopes[0], math.sqrt(2.0) * SIDE), (slopes[1], 0.0)]
    numbers = {0.0: (1, 2), math.pi / 3: (1, 2, 3), -math.pi / 3: (-1, 0, 1)}
    return [(np.array([math.cos(a), math.sin(a)]), k * HEIGHT) for a, those in numbers.items() for k in those]


@pytest.mark.parametrize("kind", ["pleats", "right", "equilateral"])
def test_a_place_and_its_mirror_image_at_any_fold_lie_upon_each_other(kind: str) -> None:
    """Folding brings no two places farther apart, so the cell that an image falls into lies no farther from the place
    on the packet than its middle does from the image on the cloth: half a cell's diagonal, a 230th of a side.
    """
    fold = {"fold": "pleats", "width": SIDE, "angle": 0.4} if kind == "pleats" else {
        "fold": "triangles", "side": SIDE, "kind": kind}  # fmt: skip
    folded = Folded.model_validate({"folds": [fold], "clamps": [BLOT]})
    fine = SIZE / 4
    shape = 4 * SHAPE[0], 4 * SHAPE[1]
    u = np.stack(fold_cells(folded.folds, shape, fine), axis=-1)
    y, x = np.indices(shape)
    place = (np.stack([x, y], axis=-1) + 0.5) * fine
    for normal, distance in mirrors(kind):
        image = place - 2.0 * ((place @ normal) - distance)[..., None] * normal
        cell = np.floor(image / fine).astype(int)
        there = ((cell >= 0) & (cell < shape[::-1])).all(axis=-1)
        assert there.sum() > 1000
        near = cell[there]
        off = np.linalg.norm((near + 0.5) * fine - image[there], axis=1)
        apart = np.linalg.norm(u[near[:, 1], near[:, 0]] - u[there], axis=1)
        assert (apart <= off + 1e-12).all()


def test_a_packet_of_triangles_is_one_triangle_and_covers_it() -> None:
    """Its corners are said: of places of 12 mm x 9.6 mm all lie in it, evenly."""
    for kind, corners in (
        ("equilateral", [[0, 0], [0, SIDE], [HEIGHT, SIDE / 2]]),
        ("right", [[0, 0], [SIDE, 0], [SIDE, SIDE]]),
    ):
        folds = Folded.model_validate(
            {"folds": [{"fold": "triangles", "side": SIDE, "kind": kind}], "clamps": [BLOT]}
        ).folds
        u, v = fold_cells(folds, (384, 480), SIZE / 4)
        middle = np.mean(corners, axis=0)
        wide = Polygon(points=[tuple(middle + (1 + 1e-9) * (np.array(c) - middle)) for c in corners])
        assert contains(wide, u, v).all()
        half = Polygon(points=[tuple(middle + math.sqrt(0.5) * (np.array(c) - middle)) for c in corners])
        assert contains(half, u, v).mean() == pytest.approx(0.5, abs=0.04)


def test_boards_on_folded_cloth_are_the_ready_pattern_of_squares(tmp_path: Path) -> None:
    squares = Shibori.model_validate({"pattern": {"pattern": "squares", "side": 0.00127}, "fold": [5, 4]})
    board = {
        "shape": "rectangle",
        "low": [0.0012 - 0.000635, 0.0012 - 0.000635],
        "high": [0.0012 + 0.000635, 0.0012 + 0.000635],
    }
    folds = {"fold": "pleats", "number": 5}, {"fold": "pleats", "number": 4, "angle": "90 deg"}
    assert np.array_equal(draw(tmp_path, *folds, clamps=[board]), find_resist(squares, SHAPE, SIZE, Folder(tmp_path)))


def test_stitches_press_every_other_length_along_their_line(tmp_path: Path) -> None:
    """Around a corner, too: 4 mm and 3 mm of stitches of 0.5 mm, 0.4 mm wide."""
    line = {"points": [[0.002, 0.003], [0.006, 0.003], [0.006, 0.006]], "width": 0.0004, "length": 0.0005}
    found = draw(tmp_path, stitches=[line])
    assert np.array_equal(found[28:32, 20:58], np.tile([1.0] * 5 + [0.0] * 5, (4, 4))[:, :38])
    assert np.array_equal(found[32:60, 58:62], np.tile([1.0] * 5 + [0.0] * 5, (4, 3)).T[2:])
    outside = np.ones(SHAPE, bool)
    outside[28:32, 20:62] = outside[28:60, 58:62] = False
    assert not found[outside].any()


@pytest.mark.parametrize(
    "region",
    [
        Disc(centre=(0.004, 0.005), diameter=0.006),
        Rectangle(low=(0.001, 0.002), high=(0.005, 0.0083)),
        Polygon(points=((0.001, 0.001), (0.011, 0.002), (0.003, 0.009), (0.003, 0.0), (0.008, 0.008))),
        Stroke(points=((0.001, 0.001), (0.011, 0.002), (0.003, 0.009)), width=0.0011),
    ],
)
def test_places_are_in_a_part_as_cells_are(region: Any) -> None:
    y, x = np.indices(SHAPE)
    assert np.array_equal(contains(region, (x + 0.5) * SIZE, (y + 0.5) * SIZE), cover(region, SHAPE, SIZE))


def test_what_is_no_packet_is_refused(tmp_path: Path) -> None:
    pleats = {"fold": "pleats", "number": 6}
    for item, words in (({"folds": [pleats]}, "add clamps or stitches"),
                        ({"folds": [pleats | {"width": 1e-3}], "clamps": [BLOT]}, "either a number or a width"),
                        ({"folds": [{"fold": "pleats"}], "clamps": [BLOT]}, "either a number or a width")):  # fmt: skip
        with pytest.raises(ValidationError, match=words):
            Folded.model_validate(item)
    beside = {"shape": "disc", "centre": [0.004, 0.004], "diameter": 0.001}
    with pytest.raises(BadInput, match=r"(?s)clamps\[1\]: beside the packet.*0\.00195, 0\.00955"):
        draw(tmp_path, pleats, clamps=[BLOT, beside])
    with pytest.raises(BadInput, match=r"folds\[1\]: folded finer than a cell"):
        draw(tmp_path, pleats, {"fold": "pleats", "number": 21})


BANDS = {"pattern": "bands", "period": "1 mm", "width": "0.4 mm"}
PITCH = {"warp": 6, "weft": 5}
"""Cells."""
CLOTH = {
    "cells": [120, 100], "cell_size": "0.05 mm", "tau3": {"I": 0.1, "II": 0.1, "III": 0.1},
    "warp": {"width": 4, "gap": 2}, "weft": {"width": 3, "gap": 2, "porosity": 0.7},
}  # fmt: skip


def build(
    root: Path, *ikat: dict[str, Any], dyes: tuple[str, ...] = ("blue",), seed: int = 3
) -> tuple[Cells, DyeState]:
    config = WovenClothConfig.model_validate(CLOTH | {"ikat": ikat})
    return WovenCloth().build(config, Folder(root), seed, dyes)


def lines(root: Path, yarns: str, seed: int = 3, **item: Any) -> Float:
    """(n, m) the share of V_d that each of a system's yarns holds, along it."""
    cells, state = build(root, {"yarns": yarns, "amount": 1} | item, seed=seed)
    layer = 1 if yarns == "warp" else 0
    share = state.fixed[0, layer] / np.where(cells.fibre[layer], cells.fixed_room[layer], 1.0)
    share = (share.T if layer else share).reshape(-1, PITCH[yarns], 100 if layer else 120)
    fibre = share[:, 1:-1]  # between half gaps of a cell
    assert (fibre == fibre[:, :1]).all(), "a yarn is dyed through"
    assert not share[:, 0].any() and not share[:, -1].any(), "and gaps are not"
    return np.asarray(fibre[:, 0])


@pytest.mark.parametrize("yarns", ["warp", "weft"])
def test_ikat_dyes_one_system_s_yarns_alone_and_as_much_of_them_as_is_said(yarns: str, tmp_path: Path) -> None:
    item = {"yarns": yarns, "pattern": BANDS, "amount": 0.5, "loose": 0.25, "dye": "blue"}
    cells, state = build(tmp_path, item, dyes=("red", "blue"))
    layer = 1 if yarns == "warp" else 0
    for amounts, share, room in ((state.fixed, 0.5, cells.fixed_room), (state.phi, 0.25, cells.mobile_room)):
        assert not amounts[0].any() and not amounts[1, 1 - layer].any()
        assert amounts[1, layer].sum() == pytest.approx(0.4 * share * room[layer][cells.fibre[layer]].sum(), rel=1e-12)


@pytest.mark.parametrize("yarns", ["warp", "weft"])
def test_each_yarn_is_off_along_itself_by_what_its_seed_says(yarns: str, tmp_path: Path) -> None:
    """Bands are as wide and as far apart as before; a yarn's own lie up to `shift` from the others'."""
    even = lines(tmp_path, yarns, pattern=BANDS)
    assert (even == even[0]).all() and (even[0] == (np.arange(even.shape[1]) % 20 < 8)).all()
    shifted = lines(tmp_path, yarns, pattern=BANDS, shift="0.2 mm")
    found = [next(k for k in range(-10, 10) if (np.roll(even[0], k) == line).all()) for line in shifted]
    assert min(found) < -1 and max(found) > 1 and max(map(abs, found)) <= 4
    assert np.array_equal(shifted, lines(tmp_path, yarns, pattern=BANDS, shift="0.2 mm"))
    assert not np.array_equal(shifted, lines(tmp_path, yarns, pattern=BANDS, shift="0.2 mm", seed=4))


def test_patterns_go_along_and_across_yarns(tmp_path: Path) -> None:
    """Lozenges cover half of the cloth; bands that lean are later on each further yarn, by tan of the angle."""
    lozenges = lines(tmp_path, "warp", pattern={"pattern": "diamonds", "along": "5 mm", "across": "3 mm"})
    assert lozenges.mean() == pytest.approx(0.5, abs=0.02)
    assert np.array_equal(lozenges, lozenges[::-1]) and np.array_equal(lozenges, lozenges[:, ::-1])
    leaning = lines(tmp_path, "warp", pattern=BANDS | {"angle": -np.arctan(2 / 3)})
    for k, line in enumerate(leaning):
        assert np.array_equal(line, np.roll(leaning[0], 4 * k)), "6 cells further on, 4 cells later"


def test_an_image_dyes_where_it_is_black(tmp_path: Path) -> None:
    """Read at each yarn's middle; a shift of a yarn moves what lies on it, by shares of cells too."""
    values = np.random.default_rng(1).random((100, 120))
    write_image(tmp_path / "a.png", values)
    image = {"pattern": "image", "file": "a.png"}
    assert np.abs(lines(tmp_path, "warp", pattern=image) - (1.0 - values[:, 3::6].T)).max() < 2e-5
    assert np.abs(lines(tmp_path, "weft", pattern=image) - (1.0 - values[2::5])).max() < 2e-5
    ramp = np.linspace(0.0, 1.0, 100)
    write_image(tmp_path / "a.png", np.tile(ramp[:, None], 120))
    off = 99.0 * (lines(tmp_path, "warp", pattern=image, shift="0.2 mm") - (1.0 - ramp))[:, 10:-10]
    assert np.ptp(off, axis=1).max() < 5e-3, "a yarn is off by the same all along"
    assert off.min() < -2.0 and off.max() > 2.0 and np.abs(off).max() < 4.01


@pytest.mark.parametrize("name", SOLVERS)
def test_what_was_dyed_before_weaving_does_not_run(name: str, tmp_path: Path) -> None:
    """To the last bit, beside another dye's loose dye that does."""
    items = ({"pattern": BANDS, "amount": 0.5}, {"pattern": BANDS, "dye": "red", "amount": 0, "loose": 0.5})
    cells, state = build(tmp_path, *items, dyes=("blue", "red"))
    law = Langmuir().prepare(Langmuir.Config(K=0.1))
    dyes = tuple(Dye(name, 5e-10, 0.5, law) for name in ("blue", "red"))
    system, before = DyeSystem(cells, dyes), (state.fixed.copy(), state.phi.copy())
    plugin, config, _ = SOLVERS[name]
    memory = plugin.prepare(config, system, state)
    assert plugin.advance(system, state, memory, 5, 1.0).status == "ok"
    assert np.array_equal(state.fixed[0], before[0][0]) and not state.phi[0].any()
    assert (state.phi[1] != before[1][1]).any() and state.fixed[1].any()


def test_what_is_no_ikat_is_refused(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match=r"(?s)ikat\[1\].dye.*did you mean 'blue'"):
        build(tmp_path, {"pattern": BANDS}, {"pattern": BANDS, "dye": "bleu"})
    for item, words in (({"pattern": BANDS, "yarns": "both"}, "'warp' or 'weft'"), ({}, "pattern"),
                        ({"pattern": BANDS, "shift": -1.0}, "greater than or equal to 0")):  # fmt: skip
        with pytest.raises(ValidationError, match=words):
            TypeAdapter(Ikat).validate_python(item)
