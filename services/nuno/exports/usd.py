"""Export of a recording as a .usdz file: cloth and bodies over time, with texture coordinates, prints and panels."""

from __future__ import annotations

import zipfile
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from nuno.bus.encodings import origin_of
from nuno.collision.bodies import vertex_normals
from nuno.exports.cloth import (
    BODY,
    PLAIN,
    Pieces,
    ShownPiece,
    body_vertices,
    check_size,
    paint_stretch,
    read_bodies,
    read_frame,
)
from nuno.exports.dyed_pictures import read_dyed_object
from nuno.exports.meshes import panel_runs
from nuno.output_files import Progress, check_target, following, load_extra, writing
from nuno.process import scratch
from nuno.recording.reader import Recording, opened
from nuno.recording.recorded import Frame
from nuno_schemas.colour import parse_hex
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Float, Int
from nuno_schemas.messages import FABRIC, STATE

SUFFIX = ".usdz"
ROUGHNESS = 0.9
"""Roughness of UsdPreviewSurface."""
BODIES, MATERIALS = "/run/bodies", "/run/materials"
AT_ONCE = 64
"""Number of frames that are kept in memory before they are written."""


def export_usd(
    source: Recording | Path | str, path: Path, frame: int | None = None, progress: Progress | None = None
) -> Path:
    """Write the cloth and bodies of every frame, or of one, as .usdz: y up, metres, one time code per frame.

    Positions, float32, are about an origin to which the root is moved. Every panel of a sewn garment is a subset of its
    faces, of the family "panel". Cloth that is dyed while it moves has the image of the last frame. Raises BadInput for
    another ending, frames that are missing or not finite, a recording without faces, and if usd-core is not installed.
    """
    check_usd(path)
    with opened(source) as recording, writing(path, SUFFIX) as new, scratch() as folder:
        stage, pxr = folder / "run.usdc", _pxr()
        try:
            _Writer(recording, stage, frame).write(progress)
            done, why = pxr.UsdUtils.CreateNewUsdzPackage(str(stage), str(new)), ""
            done = done and zipfile.is_zipfile(new)  # pxr says nothing of bytes that the disk did not take
        except pxr.Tf.ErrorException as error:
            done, why = False, f": {error}"
        if not done:
            remedy = "make room, there and for temporary files (TMPDIR), or choose another place"
            raise BadInput(f"USD cannot be written{why}", field="--usd", value=str(path), remedy=remedy)
    return path


def check_usd(path: Path) -> None:
    """Raise BadInput for another ending, a file that would be lost, and if usd-core is not installed."""
    check_target(path, SUFFIX)
    _pxr()


def _pxr() -> Any:
    parts = ("Gf", "Sdf", "Tf", "Usd", "UsdGeom", "UsdShade", "UsdUtils", "Vt")
    names = ("pxr", *(f"pxr.{part}" for part in parts))
    return load_extra(names, "USD needs usd-core", "usd", "export a .glb")


class _Writer:
    """Writes a stage's file, and images next to it: all frames with their time codes, or a single one without."""

    def __init__(self, recording: Recording, path: Path, frame: int | None) -> None:
        self.recording, self.folder, self.frame, self.pxr = recording, path.parent, frame, _pxr()
        self.stage = stage = self.pxr.Usd.Stage.CreateNew(str(path))
        self.pxr.UsdGeom.SetStageUpAxis(stage, self.pxr.UsdGeom.Tokens.y)
        self.pxr.UsdGeom.SetStageMetersPerUnit(stage, 1.0)
        self.root = self.pxr.UsdGeom.Xform.Define(stage, "/run")
        stage.SetDefaultPrim(self.root.GetPrim())
        self.changes = frame is None and recording.counts.get(FABRIC.name, 0) > 1
        """Whether operations change the cloth's faces."""
        self.pxr.UsdGeom.Scope.Define(stage, MATERIALS)
        self.names: dict[tuple[str, str], str] = {}
        """Paths by name and parent."""
        self.shaped: dict[str, ShownPiece | None] = {}
        """The piece of cloth of each mesh, by path; None for bodies."""

    def write(self, progress: Progress | None) -> None:
        """Write all frames. Raises BadInput."""
        cloth, bodies = Pieces(self.recording), read_bodies(self.recording)
        frames: Iterable[Frame] = self.recording.frames()
        number, time_code = self.recording.counts.get(STATE.name, 0), self.pxr.Usd.TimeCode
        if self.frame is not None:
            frames, number = [read_frame(self.recording, self.frame)], 1
        origin, shown = None, None
        for done, shown in enumerate(following(frames, number, progress), 1):
            x, code = shown.x, time_code(shown.number) if self.frame is None else time_code.Default()
            pieces = cloth.at(shown.t)
            check_size(self.recording, pieces, shown, finite=True)
            if origin is None:
                origin = origin_of(x)
                self.root.AddTranslateOp().Set(self.pxr.Gf.Vec3d(*origin.tolist()))
                self.stage.SetStartTimeCode(shown.number)
            self.stage.SetEndTimeCode(shown.number)
            for piece in pieces:
                if len(piece.faces):
                    self.add_cloth(piece, x[piece.start : piece.stop] - origin, code)
            points = body_vertices(self.recording, bodies, shown.t)
            if bodies is not None and len(points):
                self.bind(self.add_mesh(BODIES, points - origin, bodies.faces, None, code), BODY)
            if done % AT_ONCE == 0:
                self.stage.Save()
        if shown is None or not self.shaped:
            problem, remedy = "nothing in the recording has faces", "a net has none: export .npz"
            raise BadInput(problem, str(self.recording.path), remedy=remedy)
        if shown.t > 0.0:
            self.stage.SetTimeCodesPerSecond(rate := round(shown.number / shown.t, 6))
            self.stage.SetFramesPerSecond(rate)
        dyed = read_dyed_object(self.recording)
        for piece in pieces if dyed is None else dyed.dress(pieces, shown.t):
            if len(piece.faces):
                self.colour(piece)
        self.stage.Save()

    def name(self, of: str, parent: str) -> str:
        """Return the unique USD path, of letters, digits and _, for a name of ours in a parent."""
        if (of, parent) not in self.names:
            plain = f"{parent}/{self.pxr.Tf.MakeValidIdentifier(of)}"
            candidates = (plain, *(f"{plain}_{k}" for k in range(2, 4 + len(self.names))))
            taken = {BODIES, MATERIALS, *self.names.values()}
            self.names[of, parent] = next(name for name in candidates if name not in taken)
        return self.names[of, parent]

    def add_mesh(self, path: str, x: Float, faces: Int, piece: ShownPiece | None, code: Any) -> Any:
        """Set the points of a mesh, and its faces if they are new, and return it."""
        mesh, vt = self.pxr.UsdGeom.Mesh.Define(self.stage, path), self.pxr.Vt
        if path not in self.shaped or self.shaped[path] is not piece:
            # Changing faces are valid from one time code to the next.
            when = code if self.changes else self.pxr.Usd.TimeCode.Default()
            mesh.GetFaceVertexCountsAttr().Set(vt.IntArray.FromNumpy(np.full(len(faces), 3, np.int32)), when)
            mesh.GetFaceVertexIndicesAttr().Set(vt.IntArray.FromNumpy(np.ascontiguousarray(faces).ravel()), when)
            mesh.GetSubdivisionSchemeAttr().Set(self.pxr.UsdGeom.Tokens.none)
            mesh.GetPrim().SetDisplayName("bodies" if piece is None else piece.name)
            mesh.SetNormalsInterpolation(self.pxr.UsdGeom.Tokens.vertex)
            if piece is not None:
                self.lay_out(mesh, piece, when)
            self.shaped[path] = piece
        mesh.GetPointsAttr().Set(_vectors(vt, x), code)
        mesh.GetNormalsAttr().Set(_vectors(vt, vertex_normals(x, faces)), code)
        mesh.GetExtentAttr().Set(_vectors(vt, np.stack([x.min(axis=0), x.max(axis=0)])), code)
        return mesh

    def add_cloth(self, piece: ShownPiece, x: Float, code: Any) -> None:
        """Add a piece at x (n, 3) [m], painted by its stretch if it has neither colour nor image."""
        mesh = self.add_mesh(self.name(piece.name, "/run"), x, piece.faces, piece, code)
        if piece.colour is None and piece.image is None and len(piece.edges):
            painted = mesh.CreateDisplayColorPrimvar(self.pxr.UsdGeom.Tokens.vertex)
            painted.Set(_vectors(self.pxr.Vt, paint_stretch(piece.stretch(x))), code)

    def lay_out(self, mesh: Any, piece: ShownPiece, when: Any) -> None:
        """Set texture coordinates and panels of a mesh."""
        geom, vt, sdf = self.pxr.UsdGeom, self.pxr.Vt, self.pxr.Sdf
        mesh.GetDoubleSidedAttr().Set(True)
        if (laid := piece.laid_out) is not None:
            kind = sdf.ValueTypeNames.TexCoord2fArray
            st = geom.PrimvarsAPI(mesh).CreatePrimvar("st", kind, geom.Tokens.faceVarying)
            st.Set(vt.Vec2fArray.FromNumpy(np.ascontiguousarray(laid.points, np.float32)), when)
            st.SetIndices(vt.IntArray.FromNumpy(np.ascontiguousarray(laid.faces).ravel()), when)
        for name, first, stop in panel_runs(piece):
            if name:
                path = self.name(name, str(mesh.GetPath()))
                subset = geom.Subset.Define(self.stage, path)
                subset.GetElementTypeAttr().Set(geom.Tokens.face)
                subset.GetFamilyNameAttr().Set("panel")
                subset.GetIndicesAttr().Set(vt.IntArray.FromNumpy(np.arange(first, stop, dtype=np.int32)), when)
                subset.GetPrim().SetDisplayName(name)

    def colour(self, piece: ShownPiece) -> None:
        """Give a piece its material, by its image, else its colour, unless it is painted by its stretch."""
        mesh = self.pxr.UsdGeom.Mesh.Get(self.stage, self.name(piece.name, "/run"))
        if piece.image is not None and piece.laid_out is not None:
            image = f"{mesh.GetPath().name}.png"
            Image.fromarray(piece.image).save(self.folder / image)
            self.bind(mesh, image=f"./{image}")
        elif piece.colour is not None or not len(piece.edges):
            self.bind(mesh, piece.colour or PLAIN)

    def bind(self, mesh: Any, colour: str = PLAIN, image: str | None = None) -> None:
        """Give a mesh a matt material of a colour "#rrggbb" or an image, unless it has one."""
        shade, types = self.pxr.UsdShade, self.pxr.Sdf.ValueTypeNames
        token = f"{MATERIALS}/{mesh.GetPath().name}"
        if self.stage.GetPrimAtPath(token):
            return
        material = shade.Material.Define(self.stage, token)
        surface = shade.Shader.Define(self.stage, f"{token}/surface")
        surface.CreateIdAttr("UsdPreviewSurface")
        surface.CreateInput("roughness", types.Float).Set(ROUGHNESS)
        diffuse = surface.CreateInput("diffuseColor", types.Color3f)
        if image is None:
            diffuse.Set(self.pxr.Gf.Vec3f(*parse_hex(colour).tolist()))
        else:
            reader = shade.Shader.Define(self.stage, f"{token}/st")
            reader.CreateIdAttr("UsdPrimvarReader_float2")
            reader.CreateInput("varname", types.String).Set("st")
            texture = shade.Shader.Define(self.stage, f"{token}/image")
            texture.CreateIdAttr("UsdUVTexture")
            texture.CreateInput("file", types.Asset).Set(image)
            texture.CreateInput("sourceColorSpace", types.Token).Set("sRGB")
            for side in ("wrapS", "wrapT"):
                texture.CreateInput(side, types.Token).Set("repeat")
            st = texture.CreateInput("st", types.Float2)
            st.ConnectToSource(reader.CreateOutput("result", types.Float2))
            diffuse.ConnectToSource(texture.CreateOutput("rgb", types.Float3))
        material.CreateSurfaceOutput().ConnectToSource(surface.CreateOutput("surface", types.Token))
        shade.MaterialBindingAPI.Apply(mesh.GetPrim()).Bind(material)


def _vectors(vt: Any, x: Float) -> Any:
    """Convert x (n, 3) to USD's array type."""
    return vt.Vec3fArray.FromNumpy(np.ascontiguousarray(x, np.float32))
