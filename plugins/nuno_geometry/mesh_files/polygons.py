"""Polygons of mesh files, OBJ and PLY among them, and triangles of polygons: convex or not, flat or not."""

from __future__ import annotations

import codecs
import math
import re
import struct
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Bool, Float, Int
from nuno_schemas.reading import with_point
from nuno_schemas.vectors import unit_rows

# The content of a mesh file, and triangles of its polygons: convex or not, flat or not, the same ones whichever corner
# comes first.
#
# A fan is right where a polygon is convex; a quad with one corner that is not convex is a fan from there. All else
# loses its ears one by one, the roundest first, so that no triangle is thinner than need be. Corners on a straight side
# stay: the polygon beyond that side may end there. Rejected: mapbox_earcut, which drops such corners and so opens the
# surface; a fan from the first corner, whose triangles overlap on a concave polygon.

Places = NDArray[np.int64]
ROUNDING = 1e-10
"""share of the squared extent that an area is off by at most"""
STRAIGHT = 1e-3
"""Sine of the turn at a corner on a straight side, or less, as files round it; and the share of a triangle's side that
no other corner lies nearer to it than, if it can be. Else triangles would be slivers."""
FLAT = 1e-6
"""share of the extent by which corners of a flat polygon may lie off its plane"""
MOST_CORNERS = 2048
"""most corners of a polygon that is not convex: ears take quadratic time"""


@dataclass(frozen=True)
class RawMesh:
    """A file's triangles, with its own numbers and in its order.

    points (n, 3) in the file's unit, also those of no triangle; faces (f, 3); uv (f, 3, 2) texture coordinates of each
    corner, v upwards, NaN where it has none; None where none has any; lines: of each line of an OBJ file the points;
    corners: of an OBJ or PLY file the points (c,) of all polygons' corners
    """

    points: Float
    faces: Int
    uv: NDArray[np.float32] | None = None
    lines: tuple[Places, ...] = ()
    corners: Places = field(default_factory=lambda: np.zeros(0, np.int64))


def plain(data: bytes) -> bytes:
    r"""Text in UTF-8 whose lines end in \n, without a byte order mark. Raises ValueError for broken UTF-16."""
    if data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        data = data.decode("utf-16").encode()
    return data.removeprefix(codecs.BOM_UTF8).replace(b"\r\n", b"\n").replace(b"\r", b"\n")


def triangulate(points: Float, corner: Places, count: Places, lines: Sequence[int] = ()) -> Places:
    """Return the triangles (t, 3) of polygons with `count` (p,) corners each, `corner` (c,) vertices of points (n, 3),
    as places in `corner`: polygon by polygon, counter-clockwise as these are.

    Corners that repeat the one before them are left out. Raises BadInput, with the polygon's number and its line in the
    file, for one that passes through itself.
    """
    owner, place = np.repeat(np.arange(len(count)), count), np.arange(len(corner))
    if (count > 3).any():
        following = place + 1
        following[np.cumsum(count) - 1] -= count
        kept = (count[owner] <= 3) | (corner != corner[following])
        owner, place = owner[kept], place[kept]
        count = np.bincount(owner, minlength=len(count))
    first = np.cumsum(count) - count
    found, of = [], []
    for n in np.unique(count[count >= 3]).tolist():
        corners = np.flatnonzero(count == n)
        each = place[first[corners, None] + np.arange(n)]
        x = points[corner[each]]
        fan, start = _fans(x) if n > 3 else (np.ones(len(corners), bool), np.zeros(len(corners), np.int64))
        turned = np.take_along_axis(each, (start[:, None] + np.arange(n)) % n, axis=1)
        fans = np.stack([np.repeat(turned[:, :1], n - 2, axis=1), turned[:, 1:-1], turned[:, 2:]], axis=2)[fan]
        found.append(fans.reshape(-1, 3))
        of.append(np.repeat(corners[fan], n - 2))
        for k in np.flatnonzero(~fan).tolist():
            try:
                ears = _clip(np.roll(x[k], -start[k], axis=0))
            except ValueError as error:
                number = int(corners[k])
                raise BadInput(
                    f"a polygon {error}", field=f"face {number}", value=f"{n} corners",
                    line=lines[number] if number < len(lines) else None,
                    remedy="triangulate it in the program that it comes from",
                ) from None  # fmt: skip
            found.append(turned[k][ears])
            of.append(np.full(len(ears), corners[k]))
    if not found:
        return np.zeros((0, 3), np.int64)
    return np.concatenate(found)[np.argsort(np.concatenate(of), kind="stable")]


def _fans(x: Float) -> tuple[Bool, Places]:
    """Return whether polygons (m, n, 3) are a fan from one of their corners (m,), and the corner to begin at (m,).

    A flat one begins where its file does. How one bends that is not flat follows from where it is cut, so it begins at
    the corner nearest to its middle, of equally near ones the first by x, y and z.
    """
    n = x.shape[1]
    with np.errstate(invalid="ignore", over="ignore"):
        middle = x.mean(axis=1, keepdims=True)
        y = x - middle
        extent = np.abs(y).max(axis=(1, 2))[:, None]
        normal = unit_rows(np.cross(y, np.roll(y, -1, axis=1)).sum(axis=1))[:, None]

        def turns(one: Float, other: Float, least: float) -> Bool:
            size = np.linalg.norm(one, axis=2) * np.linalg.norm(other, axis=2)
            return np.asarray((np.cross(one, other) * normal).sum(axis=2) > least * size)

        side = np.roll(y, -1, axis=1) - y
        left = turns(np.roll(side, 1, axis=1), side, STRAIGHT)
        fan: Bool = np.asarray(left.all(axis=1))
        if (
            n > 4
        ):  # all corners turn left in a star too: only in a convex polygon is each side seen alike from the first
            first, beyond = y[:, 1:-1] - y[:, :1], y[:, 2:] - y[:, :1]
            fan &= (turns(first, beyond, ROUNDING) & turns(first[:, :1], beyond, ROUNDING)).all(axis=1)
        flat = (np.abs((y * normal).sum(axis=2)) <= FLAT * extent).all(axis=1)
        near = np.round((y * y).sum(axis=2) / np.where(extent > 0.0, extent, 1.0) ** 2, 6)
    start, cut = np.zeros(len(x), np.int64), ~(fan & flat)
    start[cut] = np.lexsort((*np.moveaxis(x[cut], 2, 0)[::-1], near[cut]), axis=1)[:, 0]
    if n == 4:
        one = (~left).sum(axis=1) == 1
        start[one] = np.argmin(left[one], axis=1)
        fan |= one | ~flat
    return fan, start


def _clip(x: Float) -> Places:
    """Return the corners (n - 2, 3) of a polygon's (n, 3) triangles. Raises ValueError for one that crosses itself."""
    n = len(x)
    if n > MOST_CORNERS:
        raise ValueError(f"has more than {MOST_CORNERS} corners")
    y = x - x.mean(axis=0)
    least = ROUNDING * float(np.abs(y).max()) ** 2
    normal = np.cross(y, np.roll(y, -1, axis=0)).sum(axis=0)
    size = float(np.linalg.norm(normal))
    if not size > least:
        if not (np.linalg.norm(np.cross(y[1:-1] - y[0], y[2:] - y[0]), axis=1) > least).any():
            return np.stack([np.zeros(n - 2, np.int64), np.arange(1, n - 1), np.arange(2, n)], axis=1)  # a line
        raise ValueError("passes through itself")
    u = np.cross(np.eye(3)[np.argmin(np.abs(normal))], normal)
    u /= np.linalg.norm(u)
    p = np.stack([y @ u, y @ np.cross(normal, u) / size], axis=1)
    _check_simple(p, least)
    left, ears, width = list(range(n)), [], [_width(p, k, list(range(n)), least) for k in range(n)]
    while len(left) > 3:
        k = int(np.argmax(width))
        if not width[k] > 0.0:  # its obstacle may be gone
            width = [_width(p, j, left, least) for j in range(len(left))]
            k = int(np.argmax(width))
        if not width[k] > 0.0:
            raise ValueError("touches itself, so that it has no inside")
        ears.append([left[k - 1], left[k], left[(k + 1) % len(left)]])
        del left[k], width[k]
        for j in (k - 1, k % len(left)):
            width[j] = _width(p, j % len(left), left, least)
    return np.array([*ears, left])


def _cross(a: Float, b: Float, c: Float) -> Float:
    """Return twice the area of triangles in the plane."""
    return np.asarray(
        (b[..., 0] - a[..., 0]) * (c[..., 1] - a[..., 1]) - (b[..., 1] - a[..., 1]) * (c[..., 0] - a[..., 0])
    )


def _check_simple(p: Float, least: float) -> None:
    """Raise ValueError for a polygon in the plane (n, 2) two of whose sides cross; they may touch, as a slit's do."""
    end = np.roll(p, -1, axis=0)
    for k in range(len(p) - 2):
        a, b, c, d = p[k], end[k], p[k + 2 :], end[k + 2 :]
        sides = np.stack([_cross(a, b, c), _cross(a, b, d), _cross(c, d, a), _cross(c, d, b)])
        way = np.where(np.abs(sides) > least, np.sign(sides), 0.0)
        if ((way[0] * way[1] < 0.0) & (way[2] * way[3] < 0.0)).any():
            raise ValueError("passes through itself")


def _width(p: Float, k: int, left: list[int], least: float) -> float:
    """Return the roundness of the ear at the k-th corner left, its area over its longest side squared; 0 for none, and
    little if a corner lies next to the side that is cut, for that would leave a sliver.
    """
    a, b, c = p[left[k - 1]], p[left[k]], p[left[(k + 1) % len(left)]]
    area = float(_cross(a, b, c))
    if area <= least:
        return 0.0
    others = p[left]
    inside = (_cross(a, b, others) >= -least) & (_cross(b, c, others) >= -least) & (_cross(c, a, others) >= -least)
    apart = np.all([(others != corner).any(axis=1) for corner in (a, b, c)], axis=0)
    if (inside & apart).any():
        return 0.0
    side, along = float(((c - a) ** 2).sum()), ((others - a) * (c - a)).sum(axis=1)
    near = (np.abs(_cross(a, c, others)) < STRAIGHT * side) & (along > 0.0) & (along < side) & apart
    width = area / max(side, float(((b - a) ** 2).sum()), float(((c - b) ** 2).sum()))
    return 1e-6 * width if near.any() else width


# Polygons of Wavefront OBJ files (Wavefront, Advanced Visualizer manual, appendix B1: object files, version 3.0).


def read_obj(data: bytes) -> RawMesh:
    """Read an OBJ file: faces with their texture coordinates, and lines; all else is left out.

    Raises BadInput with the line of what cannot be read.
    """
    # A backslash continues a line: joined by a vertical tab, which is a blank, lines can still be counted.
    text = re.sub(rb"#[^\n]*", b"", plain(data)).replace(b"\\\n", b"\v")
    points: list[tuple[float, float, float]] = []
    texture: list[tuple[float, float]] = [(np.nan, np.nan)]  # the first is of corners without any
    corner: list[int] = []
    drawn: list[int] = []
    count: list[int] = []
    lines: list[int] = []
    strokes: list[list[int]] = []
    number, following = 1, 1
    for line in text.split(b"\n"):
        number, following = following, following + 1 + line.count(b"\v")
        words = line.split()
        if not words:
            continue
        kind = words[0]
        try:
            if kind == b"v":
                points.append((float(words[1]), float(words[2]), float(words[3])))
                if not all(map(math.isfinite, points[-1])):
                    raise ValueError("not a finite position")
            elif kind == b"vt":
                texture.append((float(words[1]), float(words[2]) if len(words) > 2 else 0.0))
            elif kind in (b"f", b"fo"):
                for word in words[1:]:
                    parts = word.split(b"/")
                    corner.append(_index(parts[0], len(points), "vertex"))
                    has = len(parts) > 1 and parts[1] != b""
                    drawn.append(_index(parts[1], len(texture) - 1, "texture coordinate") + 1 if has else 0)
                count.append(len(words) - 1)
                lines.append(number)
                if len(words) < 4:
                    raise ValueError(f"a face of {len(words) - 1} corners")
            elif kind == b"l":
                strokes.append([_index(word.split(b"/")[0], len(points), "vertex") for word in words[1:]])
                if len(words) < 3 or max(strokes[-1]) >= len(points):
                    raise ValueError("a line has two vertices at least, which stand before it")
        except (ValueError, IndexError) as error:
            reason = str(error) if isinstance(error, ValueError) else "numbers are missing"
            shown = b" ".join(words).decode("utf-8", "replace")
            problem, remedy = f"cannot be read as OBJ: {reason}", with_point(reason)
            raise BadInput(problem, line=number, field="file", value=shown, remedy=remedy) from None
    for what, numbers, available in (("vertex", corner, len(points)), ("texture coordinate", drawn, len(texture))):
        if max(numbers, default=0) >= max(available, 1):
            at = int(np.searchsorted(np.cumsum(count), numbers.index(max(numbers)), side="right"))
            raise BadInput(
                f"cannot be read as OBJ: a triangle of a {what} that is not there", field="file", line=lines[at],
                value=max(numbers) + (what == "vertex"), limit=f"the file has {available - (what != 'vertex')}",
            )  # fmt: skip
    x, corners = np.array(points, np.float64).reshape(-1, 3), np.array(corner, np.int64)
    place = triangulate(x, corners, np.array(count, np.int64), lines)
    uv = np.array(texture, np.float32)[np.array(drawn, np.int64)[place]] if any(drawn) else None
    return RawMesh(x, corners[place].astype(np.int32), uv, tuple(np.array(stroke) for stroke in strokes), corners)


def _index(word: bytes, available: int, what: str) -> int:
    """Return a number from 1, or from -1 backwards among those available, as one from 0."""
    number = int(word)
    if number == 0 or number < -available:
        raise ValueError(f"a triangle of a {what} that is not there")
    return number - 1 if number > 0 else available + number


# Polygons of PLY files, ASCII and binary (G. Turk, The PLY polygon file format, Stanford, 1994).

TYPES = {
    "char": "b", "uchar": "B", "short": "h", "ushort": "H", "int": "i", "uint": "I", "float": "f", "double": "d",
    "int8": "b", "uint8": "B", "int16": "h", "uint16": "H", "int32": "i", "uint32": "I", "float32": "f", "float64": "d",
}  # fmt: skip
ORDERS = {"binary_little_endian": "<", "binary_big_endian": ">", "ascii": ""}
END = "end_header"
DRAWN = (("s", "t"), ("u", "v"), ("texture_u", "texture_v"))
"""common names of texture coordinates of vertices"""
Table = dict[str, tuple[NDArray[np.float64], NDArray[np.int64]]]
"""all numbers of each property of an element, and how many each row has (rows,)"""
NOTHING = np.zeros(0), np.zeros(0, np.int64)


class Property(NamedTuple):
    """A number of each row, or a list of numbers whose count has the type `length`."""

    name: str
    kind: str
    length: str = ""


def read_ply(data: bytes) -> RawMesh:
    """Read a PLY file's surface, with the texture coordinates of its vertices or of its faces' corners.

    Raises ValueError or LookupError for a file that is none, and BadInput as `triangulate`.
    """
    head, pairs, text = plain(data).partition(b"\n" + END.encode() + b"\n")
    if not head.startswith(b"ply\n") or not pairs:
        raise ValueError("it has no header")
    order, elements = _header(head.decode("utf-8", "replace").splitlines()[1:])
    if order:
        data = data[data.index(END.encode()) + len(END) :]
        data = data[2 if data.startswith(b"\r\n") else 1 :]
    else:  # as if all words were float64, which hold numbers of vertices
        data, order = np.array(text.split(), np.float64).tobytes(), "="
        elements = {
            name: (rows, [Property(one.name, "d", "d" if one.length else "") for one in row])
            for name, (rows, row) in elements.items()
        }
    at, tables = 0, dict[str, Table]()
    for name, (rows, row) in elements.items():
        try:
            tables[name], at = _read(data, at, rows, row, order)
        except (struct.error, ValueError):
            raise ValueError(f"it ends before the last {name} of {rows}") from None
    if order == "=" and at < len(data):
        raise ValueError("it has more numbers than its header says")
    vertex, face = tables.get("vertex", {}), tables.get("face", {})
    x = np.stack([vertex.get(axis, NOTHING)[0] for axis in "xyz"], axis=1)
    corner, count = face.get("vertex_indices", face.get("vertex_index", NOTHING))
    if corner.size and not 0 <= corner.min() <= corner.max() < len(x):
        raise ValueError(f"triangles of vertices {corner.min():g} to {corner.max():g}, and there are {len(x)}")
    if "tristrips" in tables:
        raise ValueError("its triangles are in strips, which are not read")
    place, uv = triangulate(x, corner.astype(np.int64), count), None
    faces = corner.astype(np.int64)[place]
    if "texcoord" in face and (face["texcoord"][1] == 2 * count).all():
        uv = face["texcoord"][0].reshape(-1, 2)[place].astype(np.float32)
    for u, v in DRAWN:
        if u in vertex and v in vertex:
            uv = np.stack([vertex[u][0], vertex[v][0]], axis=1)[faces].astype(np.float32)
    return RawMesh(x, faces.astype(np.int32), uv, corners=corner.astype(np.int64))


def _header(lines: list[str]) -> tuple[str, dict[str, tuple[int, list[Property]]]]:
    """Return the order of bytes, "" for words, and the number of rows and the properties of each element."""
    order, elements = None, dict[str, tuple[int, list[Property]]]()
    for words in (line.split() for line in lines):
        match words:
            case ["format", name, _] if name in ORDERS:
                order = ORDERS[name]
            case ["element", name, rows]:
                elements[name] = int(rows), []
            case ["property", "list", length, kind, name] if elements:
                elements[list(elements)[-1]][1].append(Property(name, TYPES[kind], TYPES[length]))
            case ["property", kind, name] if elements:
                elements[list(elements)[-1]][1].append(Property(name, TYPES[kind]))
            case ["comment" | "obj_info", *_] | []:
                pass
            case _:
                raise ValueError(f"its header says {' '.join(words)!r}")
    if order is None:
        raise ValueError("its header names no format")
    return order, elements


def _read(data: bytes, at: int, rows: int, row: list[Property], order: str) -> tuple[Table, int]:
    """Return the numbers of an element that begins at a byte, and the place of the next one."""
    if not any(one.length for one in row):
        kind = np.dtype([(one.name, order + one.kind) for one in row])
        table = np.frombuffer(data, kind, rows if row else 0, at)
        return {one.name: (table[one.name].astype(np.float64), np.ones(rows, int)) for one in row}, at + table.nbytes
    values: dict[str, list[float]] = {one.name: [] for one in row}
    counts: dict[str, list[int]] = {one.name: [] for one in row}
    for _ in range(rows):
        for name, code, length in row:
            count = 1
            if length:
                count = int(struct.unpack_from(order + length, data, at)[0])
                at += struct.calcsize(order + length)
            values[name].extend(struct.unpack_from(f"{order}{max(count, 0)}{code}", data, at))
            counts[name].append(count)
            at += max(count, 0) * struct.calcsize(order + code)
    return {name: (np.array(values[name], np.float64), np.array(counts[name], np.int64)) for name in values}, at
