"""Meshes of a USD stage as vertices over time: point caches, transforms, and skeletons with blend shapes."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from nuno_contact.motions.glb_clip import choose_named
from nuno_contact.motions.vertex_cache import KEEP, VertexCache, fill_gaps, make_room
from nuno_geometry.mesh_files.polygons import triangulate
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Float

SAME = 1e-4
"""time codes nearer to each other are one"""


def read_usd(path: Path, mesh: str | None, rate: float | None) -> VertexCache:
    """Read the meshes of a stage that are shown, at each time code and each sample between two.

    Raises BadInput for a file that cannot be read, is put together of several, or has no motion, for an unknown mesh, a
    frame of another topology, and without usd-core.
    """
    try:
        pxr = import_module("pxr")
        for part in ("Tf", "Usd", "UsdGeom", "UsdSkel"):
            import_module(f"pxr.{part}")
    except ImportError:
        remedy = 'install it: pip install "nuno[usd]"; or export a .glb'
        raise BadInput("USD needs usd-core, which is not installed", str(path), remedy=remedy) from None
    try:
        stage = pxr.Usd.Stage.Open(str(path))
        for layer in stage.GetUsedLayers():
            if not layer.anonymous and Path(layer.realPath.split("[")[0]).resolve() != path.resolve():
                remedy = "usdcat --flatten -o flat.usdc puts them into one, or export a .usdz"
                raise BadInput("the stage names other files", str(path), None, "file", layer.identifier, remedy=remedy)
        return _read(pxr, stage, mesh, rate)
    except pxr.Tf.ErrorException as error:
        problem = f"cannot be read as USD: {str(error).strip().splitlines()[-1]}"
        raise BadInput(problem, str(path), field="file") from None
    except BadInput as error:
        error.file = str(path)
        raise


def _read(pxr: Any, stage: Any, mesh: str | None, rate: float | None) -> VertexCache:
    geom = pxr.UsdGeom
    stage.SetEditTarget(stage.GetSessionLayer())
    pxr.UsdSkel.BakeSkinning(pxr.Usd.PrimRange.Stage(stage))
    prims = [prim for prim in pxr.Usd.PrimRange.Stage(stage, pxr.Usd.TraverseInstanceProxies())
             if prim.IsA(geom.Mesh) and geom.Imageable(prim).ComputeVisibility() != geom.Tokens.invisible
             and geom.Imageable(prim).ComputePurpose() in (geom.Tokens.default_, geom.Tokens.render)]  # fmt: skip
    prims = [prims[k] for k in choose_named([[p.GetName(), *str(p.GetPath()).split("/")] for p in prims], mesh)]
    above = [stage.GetPrimAtPath(path) for prim in prims for path in prim.GetPath().GetPrefixes()]
    moving = [*(geom.Mesh(p).GetPointsAttr() for p in prims), *map(geom.Xformable, above)]
    codes = [code for one in moving for code in one.GetTimeSamples()]
    if not codes:
        raise BadInput("nothing in the stage moves", field="file", remedy="export it with animation")
    if stage.HasAuthoredTimeCodeRange():
        start, end = stage.GetStartTimeCode(), stage.GetEndTimeCode()
        codes = [start, *(code for code in codes if start < code < end), end]
    times = fill_gaps(np.array(codes, np.float64), 1.0, SAME)
    faces, at = list[Any](), [0]
    for prim in prims:
        one, first = geom.Mesh(prim), pxr.Usd.TimeCode(times[0])
        attributes = one.GetFaceVertexIndicesAttr(), one.GetFaceVertexCountsAttr()
        corner, count = (np.array(attribute.Get(first), np.int64) for attribute in attributes)
        x, turned = _place(pxr, prim, first)
        if count.sum() != len(corner) or not 0 <= corner.min(initial=0) <= corner.max(initial=0) < len(x):
            raise BadInput("faces of vertices that are not there", field=str(prim.GetPath()))
        own = corner[triangulate(x, corner, count)]
        turned ^= one.GetOrientationAttr().Get() == geom.Tokens.leftHanded
        faces.append(at[-1] + (own[:, ::-1] if turned else own))
        at.append(at[-1] + len(x))
    positions = make_room(len(times), at[-1])
    for k, code in enumerate(times.tolist()):
        for prim, start, stop in zip(prims, at, at[1:], strict=False):
            x, _ = _place(pxr, prim, pxr.Usd.TimeCode(code))
            if len(x) != stop - start:
                value, limit = f"{len(x):,} vertices at time code {code:g}", f"{stop - start:,}"
                problem = "a frame has another topology than the first"
                raise BadInput(problem, field=str(prim.GetPath()), value=value, limit=limit, remedy=KEEP)
            positions[k, start:stop] = x
    unit, up = geom.GetStageMetersPerUnit(stage), str(geom.GetStageUpAxis(stage)).lower()
    seconds = (times - times[0]) / (rate or stage.GetTimeCodesPerSecond())
    return VertexCache(np.concatenate(faces).astype(np.int32), seconds, positions, unit, up)


def _place(pxr: Any, prim: Any, code: Any) -> tuple[Float, bool]:
    """Return the points (n, 3) of a mesh in the world, and whether its transform, which is of rows, mirrors it."""
    points = np.array(pxr.UsdGeom.Mesh(prim).GetPointsAttr().Get(code), np.float64).reshape(-1, 3)
    matrix = np.array(pxr.UsdGeom.Xformable(prim).ComputeLocalToWorldTransform(code), np.float64)
    return points @ matrix[:3, :3] + matrix[3, :3], bool(np.linalg.det(matrix[:3, :3]) < 0.0)
