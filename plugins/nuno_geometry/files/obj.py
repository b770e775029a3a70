"""Polygons of Wavefront OBJ files (Wavefront, Advanced Visualizer manual, appendix B1: object files, version 3.0)."""

from __future__ import annotations

import math
import re

import numpy as np

from nuno_geometry.files.polygons import RawMesh, plain, triangulate
from nuno_schemas.errors import BadInput
from nuno_schemas.reading import with_point


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
    return RawMesh(x, corners[place].astype(np.int32), uv, tuple(np.array(stroke) for stroke in strokes))


def _index(word: bytes, available: int, what: str) -> int:
    """Return a number from 1, or from -1 backwards among those available, as one from 0."""
    number = int(word)
    if number == 0 or number < -available:
        raise ValueError(f"a triangle of a {what} that is not there")
    return number - 1 if number > 0 else available + number
