"""What keeps dye out: images of every bit depth, lines, patterns; where it is and how much it leaves."""

from __future__ import annotations

import math
import struct
import zlib
from pathlib import Path

import numpy as np
import pytest
from pattern_files import SIZE, Folder, write_image
from pydantic import TypeAdapter, ValidationError

from nuno_dye.supplies.resist import (
    Binding,
    ImageResist,
    Paste,
    Resist,
    ShapeResist,
    Shibori,
    combine,
    find_resist,
    read_image,
    stretch,
)
from nuno_dye.supplies.shibori import Rings, Seigaiha, Squares, Stripes, draw_pattern, fold
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
