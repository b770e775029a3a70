"""Export of the cloth's vertices over time as .pc2 or .mdd, which animation programs put on a mesh of the same order.

Such a mesh is what `nuno.exports.meshes` writes of a frame, as .obj. Coordinates are the scene's, in metres, y up.
"""

from __future__ import annotations

import struct
from contextlib import ExitStack
from pathlib import Path
from typing import BinaryIO

import numpy as np

from nuno.exports.cloth import Pieces, check_size
from nuno.output_files import Progress, following, make_folder, together, writing
from nuno.recording.reader import Recording, opened
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Float
from nuno_schemas.messages import STATE


def export_pc2(source: Recording | Path | str, path: Path, progress: Progress | None = None) -> list[Path]:
    """Write a PC2 file: little-endian, a float32 position [m] of each vertex in each frame, one sample a frame.

    A path without the ending .pc2 is a folder, which gets a file of each object by its name. Raises BadInput for a file
    of several objects, which programs have as several meshes, frames that are missing, not finite or of other
    vertices than the first, and a recording without frames.
    """
    return _export(source, path, ".pc2", progress)


def export_mdd(source: Recording | Path | str, path: Path, progress: Progress | None = None) -> list[Path]:
    """Write an MDD file: big-endian, the times [s] of all frames, then a float32 position [m] of each vertex in each.

    Raises as `export_pc2`.
    """
    return _export(source, path, ".mdd", progress)


def _export(source: Recording | Path | str, path: Path, suffix: str, progress: Progress | None) -> list[Path]:
    with together(), opened(source) as recording, ExitStack() as files:
        cloth, streams, written, places = Pieces(recording), list[BinaryIO](), list[Path](), list[slice]()
        times = np.array([message.t for message in recording.messages([STATE.name])])
        for frame in following(recording.frames(), len(times), progress):
            pieces = cloth.at(frame.t)
            check_size(recording, pieces, frame, finite=True)
            if not written:
                written = _names(path, suffix, [piece.name for piece in pieces])
                places = [slice(piece.start, piece.stop) for piece in pieces]
                for place, name in zip(places, written, strict=True):
                    streams.append(files.enter_context(files.enter_context(writing(name, suffix)).open("wb")))
                    streams[-1].write(_head(suffix, place.stop - place.start, frame.number, times))
            if [slice(piece.start, piece.stop) for piece in pieces] != places:
                problem, remedy = "the cloth's vertices are others than at first", "export a folder of .obj"
                raise BadInput(problem, field=f"--{suffix[1:]}", value=f"frame {frame.number}", remedy=remedy)
            for place, stream in zip(places, streams, strict=True):
                stream.write(frame.x[place].astype("<f4" if suffix == ".pc2" else ">f4").tobytes())
        if not written:
            raise BadInput("the recording has no frame", str(recording.path))
    return written


def _names(path: Path, suffix: str, objects: list[str]) -> list[Path]:
    """Return the files of objects, and make the folder that they are in. Raises BadInput for one file of several."""
    if path.suffix.lower() == suffix:
        if len(objects) > 1:
            problem, remedy = "a file holds one object", f"give a folder: {path.with_suffix('')}"
            raise BadInput(problem, field=f"--{suffix[1:]}", value=", ".join(objects), remedy=remedy)
        return [path]
    make_folder(path)
    return [path / f"{name}{suffix}" for name in objects]


def _head(suffix: str, vertices: int, first: int, times: Float) -> bytes:
    if suffix == ".pc2":
        return struct.pack("<12siiffi", b"POINTCACHE2\0", 1, vertices, float(first), 1.0, len(times))
    return struct.pack(">ii", len(times), vertices) + times.astype(">f4").tobytes()
