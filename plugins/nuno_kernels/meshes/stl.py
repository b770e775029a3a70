"""Triangles of STL files, binary and ASCII (M. Burns, Automated fabrication, 1993, section 6.5)."""

from __future__ import annotations

import re
import struct

import numpy as np

from nuno_kernels.meshes.polygons import RawMesh, plain

HEADER, TRIANGLE = 84, 50
"""bytes before the first triangle of a binary file, and of each"""


def read_stl(data: bytes) -> RawMesh:
    """Read an STL file's surface: each triangle has vertices of its own.

    Bytes after the last triangle of a binary file are ignored if fewer than a triangle, and `endsolid` may be missing.
    Raises ValueError for another file, or one whose triangles are not as many as its header says.
    """
    room = max(len(data) - HEADER, 0) // TRIANGLE
    count = struct.unpack_from("<I", data, HEADER - 4)[0] if len(data) >= HEADER else -1
    if count == room:
        kind = np.dtype([("normal", "<f4", 3), ("points", "<f4", (3, 3)), ("attribute", "<u2")])
        points = np.frombuffer(data, kind, room, HEADER)["points"].astype(np.float64).reshape(-1, 3)
    elif (text := plain(data)).lstrip()[:5].lower() == b"solid" and b"\0" not in text[:1024]:
        words = re.findall(rb"(?i)\bvertex\s+(\S+)\s+(\S+)\s+(\S+)(?=\s+(?:vertex|endloop|endfacet))", text)
        if len(words) != 3 * len(re.findall(rb"(?i)\bendfacet\b", text)):
            raise ValueError("it ends within a triangle, or has polygons or vertices of other than three numbers")
        points = np.array(words, dtype="S").astype(np.float64).reshape(-1, 3)
    elif count < 0:
        raise ValueError("it is shorter than a header")
    else:
        raise ValueError(f"its header says that it has {count} triangles, and there is room for {room}")
    return RawMesh(points, np.arange(len(points), dtype=np.int32).reshape(-1, 3))
