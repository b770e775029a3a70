"""Export of frames as OBJ, PLY and glTF files."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from nuno.bus.encodings import origin_of
from nuno.collision.bodies import vertex_normals
from nuno.exports.cloth import Pieces, ShownPiece, body_vertices, check_size, read_bodies, read_frame, read_pieces
from nuno.exports.dyed_pictures import DyedPictures, read_dyed_object
from nuno.exports.paint import BODY, PLAIN, paint_stretch
from nuno.output_files import Progress, following, make_folder, together, writing
from nuno.recording.reader import Recording, opened
from nuno.recording.recorded import Frame
from nuno_schemas.colour import parse_hex
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Corners, Float, Int

MATT = {"metallicFactor": 0.0, "roughnessFactor": 0.9}
"""Properties of glTF's materials."""


def export_mesh(source: Recording | Path | str, path: Path, frame: int | None = None) -> Path:
    """Write one frame (default: the last) of the cloth, in the format of the name's ending.

    .obj and .ply hold the cloth: positions [m] with all their digits, faces, texture coordinates. .glb also
    holds the bodies, the texture images and colours; its positions, float32 by the format, are about an origin to
    which its nodes are moved. Raises BadInput for another ending, a missing frame or one that is not finite, or a file
    that cannot be written.
    """
    suffix = _known(path.suffix.lower(), path)
    with opened(source) as recording:
        shown = read_frame(recording, frame)
        dyed = read_dyed_object(recording) if suffix == ".glb" else None
        _write(path, suffix, recording, read_pieces(recording, shown.t), dyed, shown)
    return path


def export_meshes(
    source: Recording | Path | str, folder: Path, suffix: str, progress: Progress | None = None
) -> list[Path]:
    """Write every frame into a folder, made if it is missing: frame_00000.obj, and so on.

    Raises the errors of `export_mesh`, and BadInput where the folder has frames that would not be replaced: it would
    mix two recordings.
    """
    _known(suffix, folder)
    written, name = [], f"frame_{{:05d}}{suffix}"
    with together(), opened(source) as recording:
        there = {path.name for path in folder.glob(f"frame_*{suffix}")}
        if left := sorted(there and there - {name.format(frame.number) for frame in recording.frames()}):
            problem, remedy = "frames of another recording would stay there", "choose another folder, or empty it"
            raise BadInput(problem, field=f"--{suffix[1:]}", value=str(folder / left[0]), remedy=remedy)
        make_folder(folder)
        cloth, number = Pieces(recording), recording.counts.get("sim/state", 0)
        dyed = read_dyed_object(recording) if suffix == ".glb" else None
        for frame in following(recording.frames(), number, progress):
            path = folder / name.format(frame.number)
            _write(path, suffix, recording, cloth.at(frame.t), dyed, frame)
            written.append(path)
    return written


def _known(suffix: str, path: Path) -> str:
    if suffix not in (".obj", ".ply", ".glb"):
        remedy = "change the ending"
        raise BadInput("no such kind of mesh file", value=str(path), limit=".obj, .ply, .glb", remedy=remedy)
    return suffix


def _write(
    path: Path, suffix: str, recording: Recording, pieces: list[ShownPiece], dyed: DyedPictures | None, frame: Frame
) -> None:
    check_size(recording, pieces, frame, finite=True)
    with writing(path, suffix) as new, new.open("wb") as stream:
        if suffix == ".obj":
            _write_obj(stream, pieces, frame)
        elif suffix == ".ply":
            _write_ply(stream, pieces, frame)
        else:
            stream.write(_glb(recording, pieces if dyed is None else dyed.dress(pieces, frame.t), frame))


def _write_obj(stream: BinaryIO, pieces: list[ShownPiece], frame: Frame) -> None:
    """Write one object per piece, and one group per panel, with enough digits to restore every float64.

    OBJ counts from 1 over all pieces.
    """
    stream.write(f"# nuno frame {frame.number} at {frame.t!r} s\n".encode())
    written = 1
    for piece in pieces:
        x = frame.x[piece.start : piece.stop]
        lines = [f"o {piece.name}", *("v {!r} {!r} {!r}".format(*row) for row in x.tolist())]
        corners = piece.faces + piece.start + 1
        if (laid := piece.laid_out) is not None:
            lines += ["vt {:.9g} {:.9g}".format(*row) for row in laid.points.tolist()]
            both = np.stack([corners, laid.faces + written], axis=2).reshape(-1, 6)
            rows = ["f {}/{} {}/{} {}/{}".format(*row) for row in both.tolist()]
            for name, first, stop in panel_runs(piece):
                lines += [f"g {'_'.join(name.split())}"] if name else []
                lines += rows[first:stop]
            written += len(laid.points)
        else:
            lines += ["f {} {} {}".format(*row) for row in corners.tolist()]
        stream.write(("\n".join(lines) + "\n").encode())


def panel_runs(piece: ShownPiece) -> list[tuple[str, int, int]]:
    """Return the runs of triangles of one panel: its name, the first, and the end; "" for no panel."""
    panels = None if piece.corners is None else piece.corners.panels
    if panels is None:
        return [("", 0, len(piece.faces))]
    ends = [0, *(np.flatnonzero(np.diff(panels.of)) + 1).tolist(), len(panels.of)]
    names = (*panels.names, "")
    return [(names[panels.of[first]], first, stop) for first, stop in pairwise(ends)]


def _write_ply(stream: BinaryIO, pieces: list[ShownPiece], frame: Frame) -> None:
    """Write binary PLY, all pieces as one mesh, positions as double, texture coordinates as s and t.

    If vertices have several, along seams, these are lists per face, so that seams stay closed.
    """
    faces = np.concatenate([np.zeros((0, 3), np.int32), *(piece.faces + piece.start for piece in pieces)])
    uvs = [piece.uv for piece in pieces if piece.uv is not None and not piece.seamed]
    laid = [piece.laid_out for piece in pieces if piece.laid_out is not None]
    cut = len(laid) == len(pieces) > len(uvs)
    textured = len(uvs) == len(pieces) > 0 and sum(map(len, uvs)) == len(frame.x)
    kinds = [("x", "<f8"), ("y", "<f8"), ("z", "<f8"), *([("s", "<f4"), ("t", "<f4")] if textured else [])]
    columns = [*frame.x.T, *(np.concatenate(uvs).T if textured else [])]
    vertices = np.rec.fromarrays(columns, dtype=np.dtype(kinds))
    texcoord = "property list uchar float texcoord\n" if cut else ""
    properties = "".join(f"property {'double' if kind == '<f8' else 'float'} {name}\n" for name, kind in kinds)
    stream.write(
        f"ply\nformat binary_little_endian 1.0\ncomment nuno frame {frame.number} at {frame.t!r} s\n"
        f"element vertex {len(frame.x)}\n{properties}"
        f"element face {len(faces)}\nproperty list uchar int vertex_indices\n{texcoord}end_header\n".encode()
    )
    stream.write(vertices.tobytes())
    lists = [("uvs", "u1"), ("uv", "<f4", 6)] if cut else []
    table = np.empty(len(faces), np.dtype([("count", "u1"), ("corners", "<i4", 3), *lists]))
    table["count"], table["corners"] = 3, faces
    if cut:
        table["uvs"], table["uv"] = 6, np.concatenate([one.points[one.faces].reshape(-1, 6) for one in laid])
    stream.write(table.tobytes())


def _glb(recording: Recording, pieces: list[ShownPiece], frame: Frame) -> bytes:
    """Return a binary glTF file, which is y up and right-handed like the scene."""
    import trimesh

    scene, place = trimesh.Scene(), np.eye(4)
    place[:3, 3] = origin = origin_of(frame.x)
    for piece in pieces:
        if len(piece.faces):
            x = frame.x[piece.start : piece.stop] - origin
            split = piece.laid_out if piece.image is not None else None
            mesh = _trimesh(x, piece.faces, _visual(piece, x), split)
            if piece.corners is not None and piece.corners.panels is not None:
                mesh.metadata["panels"] = [list(run) for run in panel_runs(piece)]  # among glTF's extras
            scene.add_geometry(mesh, node_name=piece.name, geom_name=piece.name, transform=place)
    bodies = read_bodies(recording)
    points = body_vertices(recording, bodies, frame.t)
    if bodies is not None and len(points):
        mesh = _trimesh(points - origin, bodies.faces, _plain(BODY, two_sided=False))
        scene.add_geometry(mesh, node_name="bodies", geom_name="bodies", transform=place)
    if not scene.geometry:
        raise BadInput("nothing in the recording has faces", str(recording.path), remedy="a net has none: export .npz")
    return bytes(scene.export(file_type="glb", include_normals=True))


def _trimesh(x: Float, faces: Int, visual: Any, split: Corners | None = None) -> Any:
    """Return a mesh with vertex normals: trimesh would compute them with scipy, which takes a second to import.

    Vertices that are split along seams keep the normal of the whole vertex: seams are shaded smoothly.
    """
    import trimesh

    normals = vertex_normals(x, faces)
    normals[~normals.any(axis=1)] = 0.0, 1.0, 0.0  # glTF wants unit length, also of a vertex of no triangle
    if split is not None:
        x, normals, faces = x[split.vertex], normals[split.vertex], split.faces
    return trimesh.Trimesh(x, faces, vertex_normals=normals, process=False, visual=visual)


def _visual(piece: ShownPiece, x: Float) -> Any:
    """Return the texture if there is one, else the colour, else colours by stretch."""
    from PIL import Image
    from trimesh.visual import ColorVisuals, TextureVisuals
    from trimesh.visual.material import PBRMaterial

    if piece.image is not None and (laid := piece.laid_out) is not None:
        image = Image.fromarray(piece.image)
        return TextureVisuals(uv=laid.points, material=PBRMaterial(baseColorTexture=image, doubleSided=True, **MATT))
    if piece.colour is not None or not len(piece.edges):
        return _plain(piece.colour or PLAIN, two_sided=True)
    # glTF's vertex colours are linear light.
    linear = np.round(255.0 * paint_stretch(piece.stretch(x))).astype(np.uint8)
    return ColorVisuals(vertex_colors=np.concatenate([linear, np.full((len(x), 1), 255, np.uint8)], axis=1))


def _plain(colour: str, two_sided: bool) -> Any:
    from trimesh.visual import TextureVisuals
    from trimesh.visual.material import PBRMaterial

    # Factors, like vertex colours, are linear light.
    factor = [*np.round(255.0 * parse_hex(colour)).astype(np.uint8).tolist(), 255]
    return TextureVisuals(material=PBRMaterial(baseColorFactor=factor, doubleSided=two_sided, **MATT))
