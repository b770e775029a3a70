"""Vertices of a surface over time, as other programs store them: sequences of meshes, arrays, PC2 and MDD."""

from __future__ import annotations

import re
import struct
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

import numpy as np
from numpy.typing import NDArray

from nuno_geometry.mesh_files.mesh import load_mesh
from nuno_geometry.mesh_files.npz import open_npz
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Float, Int
from nuno_schemas.plugin import Files
from nuno_schemas.reading import read_as

MOST = 2 << 30
"""most memory of a cache, and size of its file [bytes]"""
KEEP = "export with modifiers that keep the mesh's vertices, or the part of the shot before it"
Positions = NDArray[np.float32]


@dataclass(frozen=True)
class VertexCache:
    """Vertices of a surface over time; between two samples each goes in a straight line.

    faces      (f, 3) int32 triangles
    times      (m,) [s] of the samples, increasing, the first 0
    positions  (m, n, 3) float32, in the file's unit and axes
    unit, up   length of that unit [m], and vertical axis
    notes      remarks for the user
    """

    faces: Int
    times: Float
    positions: Positions
    unit: float = 1.0
    up: str = "y"
    notes: tuple[str, ...] = ()

    def at(self, t: float) -> Float:
        """Return the positions (n, 3) at a time t [s] from the first sample to the last."""
        k = int(np.searchsorted(self.times, t, side="right")) - 1
        if t == self.times[k]:
            return np.asarray(self.positions[k], np.float64)
        s = (t - self.times[k]) / (self.times[k + 1] - self.times[k])
        return np.asarray((1.0 - s) * self.positions[k] + s * self.positions[k + 1], np.float64)


def make_room(samples: int, vertices: int) -> Positions:
    """Return memory for positions (m, n, 3). Raises BadInput, before any is taken, for more than MOST."""
    if (size := 12 * samples * vertices) > MOST:
        value, remedy = f"{samples:,} samples of {vertices:,} vertices: {size / 1e9:.3g} GB", "export the shot alone"
        raise BadInput("the animation is too large", field="file", value=value, limit=f"{MOST} bytes", remedy=remedy)
    return np.empty((samples, vertices, 3), np.float32)


def fill_gaps(times: Float, longest: float, same: float) -> Float:
    """Return times, ascending, with more between those that are farther apart than `longest`, and of those not farther
    apart than `same`, as files round them, the first.
    """
    times = np.unique(times)
    times = times[np.diff(times, prepend=-np.inf) > same]
    parts = np.maximum(np.ceil(np.diff(times) / longest - 1e-3), 1.0).astype(int)
    within = [np.linspace(a, b, n, endpoint=False) for a, b, n in zip(times, times[1:], parts, strict=False)]
    return np.concatenate([*within, times[-1:]])


def find_sequence(name: str, files: Files) -> list[Path]:
    """Return the files whose names differ from `name` in their last number alone, from that number on. Raises BadInput
    for a name without number, and one missing between others.
    """
    path = files.resolve(name)
    parts = re.fullmatch(r"(.*?)(\d+)(\D*)", path.name)
    if parts is None:
        remedy = "name the first of a sequence, such as hero_0001.obj: those that follow are read, too"
        raise BadInput("one mesh is no motion", str(path), field="file", value=path.name, remedy=remedy)
    same = re.compile(rf"{re.escape(parts[1])}(\d+){re.escape(parts[3])}")
    names = {int(found[1]): file.name for file in path.parent.iterdir() if (found := same.fullmatch(file.name))}
    frames = sorted(number for number in names if number >= int(parts[2]))
    if missing := sorted(set(range(frames[0], frames[-1])) - set(frames)):
        remedy = "export that frame, or name the first file after it"
        raise BadInput("a frame is missing", str(path), field="file", value=f"frame {missing[0]}", remedy=remedy)
    return [files.resolve(str(PurePosixPath(name).with_name(names[number]))) for number in frames]


def read_sequence(files: list[Path], rate: float | None) -> VertexCache:
    """Read a sequence of OBJ or PLY files. Raises BadInput for a frame of another topology, and without a rate."""
    first = load_mesh(files[0])
    positions = make_room(len(files), len(first.points))
    for k, file in enumerate(files):
        mesh = load_mesh(file) if k else first
        if len(mesh.points) != len(first.points) or not np.array_equal(mesh.corners, first.corners):
            value, limit = (f"{len(one.points):,} vertices, {len(one.corners):,} corners" for one in (mesh, first))
            problem, limit = "a frame has another topology than the first", f"{limit}, numbered as in {files[0].name}"
            raise BadInput(problem, str(file), field="file", value=value, limit=limit, remedy=KEEP)
        positions[k] = mesh.points
    return _timed(files[0], positions, first.faces, None, rate)


def read_npz(path: Path, faces: Int | None, rate: float | None) -> VertexCache:
    """Read `positions` (m, n, 3), `faces` (f, 3) and, unless `rate` is given, `times` (m,) [s] of an .npz file."""
    specs = {"positions": (("m", "n", 3), "fiu"), "faces": (("f", 3), "iu"), "times": (("m",), "fiu")}
    with open_npz(path) as file:
        file.require(["positions", "faces"], specs)
        sizes = file.sizes(specs)
        positions = make_room(sizes["m"], sizes["n"])
        arrays = file.arrays(specs)
    positions[:] = arrays["positions"]
    return _timed(path, positions, arrays["faces"], arrays.get("times"), rate)


def read_points(path: Path, faces: Int | None, rate: float | None) -> VertexCache:
    """Read a PC2 file, 3ds Max' point cache, which counts in frames; or an MDD file, LightWave's motion designer data,
    which has times [s].
    """

    def read(data: bytes) -> VertexCache:
        if mdd:
            samples, points = struct.unpack_from(">ii", data)
            times, at, every = np.frombuffer(data, ">f4", max(samples, 0), 8).astype(np.float64), 8 + 4 * samples, 1.0
        else:
            mark, _, points, _, every, samples = struct.unpack_from("<12siiffi", data)
            times, at = None, 32
            if mark != b"POINTCACHE2\0" or not every > 0.0:
                raise ValueError("it does not begin as one")
        if samples < 1 or points < 1 or len(data) - at != 12 * samples * points:
            raise ValueError(f"its header says {samples} samples of {points} points, {len(data) - at} bytes follow")
        kind = ">f4" if mdd else "<f4"
        positions = np.frombuffer(data, kind, 3 * samples * points, at).astype(np.float32).reshape(samples, points, 3)
        return _timed(path, positions, faces, times, rate and rate / every)

    mdd = path.suffix.lower() == ".mdd"
    return read_as(path, "MDD" if mdd else "PC2", read, MOST)


def _timed(path: Path, positions: Positions, faces: Int | None, times: Float | None, rate: float | None) -> VertexCache:
    """Return a cache, its times by the rate if that is given. Raises BadInput without faces or times."""
    if faces is None:
        remedy = "faces: hero.obj names the mesh that they move"
        raise BadInput("the file has positions alone", str(path), field="faces", remedy=remedy)
    if not 0 <= faces.min(initial=0) <= faces.max(initial=0) < positions.shape[1]:
        value, limit = f"vertex {faces.max():,}", f"{positions.shape[1]:,} vertices"
        raise BadInput("the faces are of another mesh", str(path), None, "faces", value, limit, "export both alike")
    times = np.arange(len(positions)) / rate if rate is not None else times
    if times is None:
        problem, remedy = "the file does not say how fast its frames follow", "frame_rate: 24 Hz, as it was exported"
        raise BadInput(problem, str(path), field="frame_rate", remedy=remedy)
    if not (np.isfinite(times).all() and (np.diff(times) > 0.0).all()):
        raise BadInput("times that do not increase", str(path), field="times", remedy="frame_rate: 24 Hz replaces them")
    return VertexCache(faces, times - times[0], positions)
