"""A body that deforms as it was animated in another program: its motion, a joint for each vertex, and its collider."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import ClassVar, Literal

import numpy as np
from pydantic import BaseModel, Field

from nuno_contact.colliders.mesh import MeshCollider
from nuno_contact.motions.glb_clip import read_clips
from nuno_contact.motions.usd_clip import read_usd
from nuno_contact.motions.vertex_cache import MOST, VertexCache, find_sequence, read_npz, read_points, read_sequence
from nuno_contact.quantities import Rate, Size, Span
from nuno_geometry.check import closed_parts, crossing_notes
from nuno_geometry.mesh_files.mesh import join_vertices, load_surface
from nuno_schemas.bodies import LARGEST, SMALLEST, Skin, unit_of
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Float
from nuno_schemas.plugin import BodyShape, Config, DrawnSkin, Files, Mover
from nuno_schemas.reading import read_as
from nuno_schemas.vectors import norm

FASTEST, TIMES = 20.0, 3.0
"""A vertex that is faster than that between two samples [m/s], and so many times faster than before and after, jumps.
"""
LOOKS = 8
"""number of samples in which the two sides of a seam are to be at one place"""
USD, SEQUENCES = ("usd", "usda", "usdc", "usdz"), ("obj", "ply")
CACHES = {"npz": read_npz, "pc2": read_points, "mdd": read_points}
TAKES = {"clip": ("glb",), "mesh": ("glb", *USD), "faces": ("pc2", "mdd")}
"""kinds of files that these fields are for"""
RECIPE = (
    "in Blender's Python console: bpy.ops.wm.alembic_import(filepath='hero.abc') and "
    "bpy.ops.wm.usd_export(filepath='hero.usdc', export_animation=True); then file: hero.usdc"
)


class AnimationConfig(Config):
    """An animated character: its vertices go exactly as in the file, straight on from sample to sample, then stay."""

    file: str = Field(description="GLB or USD; the first of a sequence of OBJ or PLY files; NPZ, PC2 or MDD")
    clip: str | list[str] | None = Field(
        default=None, description="of a GLB file, where it has several: the one, or those that play together"
    )
    mesh: str | None = Field(
        default=None, description="of a GLB or USD file: the object or prim, or one above it; all meshes unless given"
    )
    faces: str | None = Field(
        default=None, description="for PC2 and MDD, which have positions alone: a mesh file with the same vertices"
    )
    frame_rate: Rate | None = Field(
        default=None,
        description="of the file [Hz], its own unless given; of a GLB, which has none, of its samples, 24 Hz at least",
    )
    start: Span = Field(default=0.0, description="where the motion begins [s], counted from the file's first sample")
    preroll: Span = Field(default=0.0, description="how long the body holds its first pose before that [s]")
    scale: Size | None = Field(
        default=None, description="length of one of the file's units [m]; as a USD file says, else the metre"
    )
    up: Literal["y", "z"] | None = Field(
        default=None, description="which of the file's axes points up; as a USD file says, else y"
    )


class Animation:
    """A joint for each vertex of a surface that another program has animated."""

    name: ClassVar[str] = "animation"
    Config: ClassVar[type[BaseModel]] = AnimationConfig

    def resolve(self, config: AnimationConfig, files: Files) -> None:
        """Resolve the files that the motion reads beside those that the configuration names. Raises BadInput."""
        if config.file.lower().endswith(SEQUENCES):
            find_sequence(config.file, files)

    def prepare(self, config: AnimationConfig, files: Files) -> Mover:
        """Read the motion. Raises BadInput for a file that cannot be read, has no motion or one of several, or changes
        its topology, for positions that are not finite or jump, and where its rate or its faces are missing.
        """
        path = files.resolve(config.file)
        cache = _read(config, path, files)
        x = cache.positions
        if (config.up or cache.up) == "z":
            x[:, :, 1], x[:, :, 2] = x[:, :, 2], -x[:, :, 1]
        x *= np.float32(scale := config.scale or cache.unit)
        check_positions(cache, path)
        if not np.ptp(x, axis=0).any():
            remedy = "export it with its animation; a body that stands still: collider: {plugin: mesh, ...}"
            raise BadInput("nothing of it moves", str(path), field="file", remedy=remedy)
        if config.start >= cache.times[-1]:
            limit = f"the file lasts {cache.times[-1]:g} s"
            raise BadInput("nothing is left", str(path), None, "start", config.start, limit, "an earlier start")
        cache = _join_seams(cache, path)
        still = np.tile(np.array([1.0, 0.0, 0.0, 0.0]), (cache.positions.shape[1], 1))

        def pose(t: float) -> tuple[Float, Float]:
            at = min(max(t - config.preroll, 0.0) + config.start, float(cache.times[-1]))
            return still, cache.at(at)

        first, notes = pose(0.0)[1], list(cache.notes)
        size = float(np.ptp(first, axis=0).max())
        if not SMALLEST <= size <= LARGEST and (unit := unit_of(size / scale)):
            notes.append(f"it is {size:.3g} m long; with scale: {unit} it would be a person's size")
        joints, parents = tuple(map(str, range(len(first)))), np.full(len(first), -1, np.int32)
        lasts = config.preroll + float(cache.times[-1]) - config.start
        return Mover(joints, parents, first, pose, None, tuple(notes), cache.faces, lasts)


def _read(config: AnimationConfig, path: Path, files: Files) -> VertexCache:
    """Read a file as it is. Raises BadInput."""
    kind, rate = path.suffix.lower().removeprefix("."), config.frame_rate
    if kind == "abc":
        raise BadInput("Alembic is not read", str(path), field="file", remedy=RECIPE)
    if kind not in (known := ("glb", *USD, *SEQUENCES, *CACHES)):
        limit = ", ".join(f".{one}" for one in known)
        raise BadInput("unknown kind of animation", str(path), field="file", value=path.name, limit=limit)
    for field, kinds in TAKES.items():
        if (value := getattr(config, field)) is not None and kind not in kinds:
            limit = ", ".join(kinds)
            raise BadInput(f"a .{kind} file takes no {field}", str(path), None, field, value, limit, "leave it out")
    if kind == "glb":
        clips = [config.clip] if isinstance(config.clip, str) else config.clip or []
        return read_as(path, "GLB", lambda data: read_clips(data, clips, config.mesh, rate or 24.0), MOST)
    if kind in USD:
        return read_usd(path, config.mesh, rate)
    if kind in SEQUENCES:
        return read_sequence(find_sequence(config.file, files), rate)
    return CACHES[kind](path, load_surface(files.resolve(config.faces))[1] if config.faces else None, rate)


def check_positions(cache: VertexCache, path: Path) -> None:
    """Raise BadInput for a position that is not finite, and one to which the surface jumps, in metres."""
    x, times = cache.positions, cache.times
    speed = np.zeros(len(x) + 3)
    for k, frame in enumerate(x):
        if not (finite := np.isfinite(frame).all(axis=1)).all():
            vertex = int(np.argmin(finite))
            field, value = f"sample {k}, vertex {vertex}", frame[vertex].tolist()
            remedy = "repair that frame where it comes from"
            raise BadInput("not a finite position", str(path), None, field, value, remedy=remedy)
        if k:
            speed[k + 1] = float(norm(frame - x[k - 1]).max()) / (times[k] - times[k - 1])
    speed, beside = speed[2:-2], np.maximum(speed[:-4], speed[4:])  # the next but one: what jumps may jump back
    if len(jumps := 1 + np.flatnonzero((speed > FASTEST) & (speed > TIMES * beside))):
        k = int(jumps[0])
        raise BadInput(
            "the body jumps", str(path), None, f"sample {k}, vertex {norm(x[k] - x[k - 1]).argmax()}",
            f"{speed[k - 1]:.3g} m/s at {times[k]:g} s, {beside[k - 1]:.3g} m/s before and after", f"{FASTEST:g} m/s",
            remedy="begin after it: start; or smooth it where it comes from; or are scale and frame_rate wrong?",
        )  # fmt: skip


def _join_seams(cache: VertexCache, path: Path) -> VertexCache:
    """Return a cache whose vertices each have a triangle, and are one along seams, whose sides go together: files part
    them for the sake of normals and textures.
    """
    looks = np.unique(np.linspace(0, len(cache.times) - 1, LOOKS).astype(int))
    tracks = cache.positions[looks].swapaxes(0, 1).reshape(cache.positions.shape[1], -1)
    remaining, joined = join_vertices(tracks, cache.faces)
    faces = remaining[joined[cache.faces]]
    used, numbers = np.unique(faces[(faces != np.roll(faces, 1, axis=1)).all(axis=1)], return_inverse=True)
    if not len(used):
        raise BadInput("the mesh has no triangles", str(path), field="file")
    return replace(cache, faces=numbers.reshape(-1, 3).astype(np.int32), positions=cache.positions[:, used])


class SurfaceConfig(Config):
    """Everything about it is in the motion."""


class SurfaceCollider:
    """The surface of a motion that has one, `animation`. Its contact is cloth_contact.bodies."""

    name: ClassVar[str] = "surface"
    Config: ClassVar[type[BaseModel]] = SurfaceConfig
    search = MeshCollider.search

    def build(self, config: SurfaceConfig, mover: Mover | None, files: Files) -> BodyShape:
        """Build the body. Raises BadInput for a motion without surface; an open or crossed one is noted."""
        if mover is None or mover.surface is None:
            remedy = "add motion: {plugin: animation, ...}, or take collider: {plugin: mesh, ...} or skin"
            raise BadInput("the motion brings no surface", field="motion", remedy=remedy)
        x, faces = mover.offsets, mover.surface
        skin = Skin(x, np.arange(len(x), dtype=np.int32)[:, None], np.ones((len(x), 1)))
        notes, number = crossing_notes(x, faces), int((~closed_parts(faces)).sum())
        if number:
            each = "cloth meets them on both sides, and may go in where they are open"
            notes += (f"{number:,} of {len(faces):,} triangles are of parts with a rim: {each}",)
        return replace(BodyShape.of_skin(mover.joints, DrawnSkin(x, faces, skin)), notes=notes)
