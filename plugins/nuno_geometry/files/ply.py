"""Polygons of PLY files, ASCII and binary (G. Turk, The PLY polygon file format, Stanford, 1994)."""

from __future__ import annotations

import struct
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from nuno_geometry.files.polygons import RawMesh, plain, triangulate

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
    return RawMesh(x, faces.astype(np.int32), uv)


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
