"""Captured motion from a BVH file (Biovision hierarchy), read by pybvh."""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Literal, cast

import numpy as np
from pydantic import BaseModel, Field

from nuno_contact.motions.rotations import AXES, from_axis_angle, multiply, pose_skeleton, rest_positions, slerp
from nuno_contact.quantities import Later, Point, Rate, Size, Span
from nuno_schemas.bodies import rotation_matrices
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Float, Int
from nuno_schemas.plugin import Config, Files, Mover
from nuno_schemas.vectors import turn

LARGEST_FILE = 256 * 2**20
STEPS = (1e-6, 1e4)
"""Times between two frames that a motion can have [s]."""
FARTHEST = 1e6
"""From the origin that a body, or a bone's end from its joint, can be [m]."""


class BvhConfig(Config):
    """A captured motion."""

    file: str = Field(description="the BVH file, beside the scene")
    height: Size = Field(
        default=1.7, description="of the body [m]: scales the file's unit so that the skeleton at rest fits"
    )
    scale: Size | None = Field(
        default=None, description="or: length of one of the file's units [m]; goes before height"
    )
    start: Span = Field(default=0.0, description="where the motion begins [s], counted from the file's first frame")
    stop: Later | None = Field(
        default=None, description="where it ends [s], counted likewise; with the file unless given"
    )
    end: Literal["hold", "loop"] = Field(default="hold", description="what follows: hold the last pose, or loop")
    blend: Span = Field(default=0.25, description="in a loop, time over which the end fades into the beginning [s]")
    ramp: Span = Field(default=0.0, description="the motion starts still and reaches its own speed after this time [s]")
    frame_rate: Rate | None = Field(default=None, description="of the file [Hz]; its own unless given")
    up: Literal["y", "z"] = Field(default="y", description="vertical axis of the file")
    position: Point = Field(
        default=(0.0, 0.0, 0.0), description="where the body starts [m]: hips over x and z, its lowest point at y"
    )
    travel: bool = Field(
        default=True, description="keep its way over the ground; off: mean velocity taken out, it stays"
    )


def read_bvh(path: Path) -> Any:
    """A pybvh.Bvh. Raises BadInput for a file that is empty, truncated, not BVH or not finite."""
    import pybvh

    size = path.stat().st_size
    if not 0 < size <= LARGEST_FILE:
        raise BadInput("empty or too large for BVH", file=str(path), value=size, limit=f"1 to {LARGEST_FILE} bytes")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            found = pybvh.read_bvh_file(path, world_up="+y")
    except Exception as error:  # whatever a broken file makes of the reader
        remedy = "is it cut off, or not BVH? Write it anew where it comes from"
        raise BadInput(f"cannot be read as BVH: {error}", file=str(path), remedy=remedy) from None
    offsets = np.array([node.offset for node in found.nodes])
    for what, values in (("offsets", offsets), ("positions", found.root_pos), ("angles", found.joint_angles)):
        if not np.isfinite(values).all():
            raise BadInput(f"{what} that are not finite numbers", file=str(path))
    return found


def read_tree(found: Any, path: Path) -> tuple[tuple[str, ...], Int, Float, Int]:
    """Names, parents and offsets (j, 3) of all nodes, and for each its row of channels or -1.

    End sites become joints named after their parent, so that a bone ends where the file says.
    Raises BadInput for two joints of one name.
    """
    nodes, names, parents = found.nodes, [], []
    rows: list[int] = []
    place = {id(node): j for j, node in enumerate(nodes)}
    for node in nodes:
        ending = node.is_end_site()
        name = f"{node.parent.name}_end" if ending else node.name
        if name in names:
            raise BadInput("two joints have the same name", file=str(path), value=name)
        names.append(name)
        parents.append(place[id(node.parent)] if node.parent is not None else -1)
        rows.append(-1 if ending else sum(row >= 0 for row in rows))
    offsets = np.array([node.offset for node in nodes], np.float64)
    return tuple(names), np.array(parents, np.int32), offsets, np.array(rows, np.int32)


@dataclass(frozen=True)
class _Clip:
    """Sampled local rotations (m, j, 4) and root positions (m, 3) [m], dt [s] apart."""

    parents: Int
    offsets: Float
    local: Float
    root: Float
    dt: float
    loop: bool
    blend: float
    ramp: float
    drift: Float

    @property
    def duration(self) -> float:
        return float(self.root.shape[0] - 1) * self.dt

    def sample(self, t: float) -> tuple[Float, Float]:
        """Local rotations and root position at clip time t, between the two nearest frames."""
        at = min(max(t / self.dt, 0.0), self.root.shape[0] - 1.0)
        k = min(int(at), max(self.root.shape[0] - 2, 0))
        s = at - k
        if s == 0.0 or self.root.shape[0] == 1:
            return self.local[k], self.root[k]
        return slerp(self.local[k], self.local[k + 1], s), (1.0 - s) * self.root[k] + s * self.root[k + 1]

    def pose(self, t: float) -> tuple[Float, Float]:
        """World rotation (j, 4) and translation (j, 3) at simulation time t [s].

        With a ramp T the clip runs at the rate t/T until t = T: half of T behind from then on.
        A loop of period D - blend shows the clip's last `blend` seconds while its first ones
        fade in, and goes on from where it got to.
        """
        t = max(t, 0.0)
        if self.ramp > 0.0:
            t = 0.5 * t * t / self.ramp if t < self.ramp else t - 0.5 * self.ramp
        period = self.duration - self.blend
        if not self.loop or t <= period or period <= 0.0:
            local, root = self.sample(t)
        else:
            turn, since = divmod(t, period)
            local, root = self.sample(since)
            root = root + turn * self.drift
            if since < self.blend:
                s = since / self.blend
                s = s * s * (3.0 - 2.0 * s)
                old_local, old_root = self.sample(period + since)
                local, old_root = slerp(old_local, local, s), old_root + (turn - 1.0) * self.drift
                root = (1.0 - s) * old_root + s * root
        return pose_skeleton(self.parents, self.offsets, local, root)


def cut_frames(config: BvhConfig, frames: int, dt: float, path: Path) -> slice:
    """The frames between `start` and `stop`. Raises BadInput where that is less than one."""
    first = math.ceil(config.start / dt - 1e-9)
    last = frames - 1 if config.stop is None else min(frames - 1, math.floor(config.stop / dt + 1e-9))
    if first > last:
        raise BadInput(
            "the part of the file has no frame", file=str(path), field="start", value=config.start,
            limit=f"the file lasts {(frames - 1) * dt:g} s", remedy="an earlier start or a later stop",
        )  # fmt: skip
    return slice(first, last + 1)


def place_root(config: BvhConfig, clip: _Clip) -> None:
    """Take the travel out if it is not wanted, then put the clip where it starts, in place."""
    frames = clip.root.shape[0]
    if not config.travel and frames > 1:
        way = (clip.root[-1] - clip.root[0]) * np.array([1.0, 0.0, 1.0])
        clip.root[:] -= np.linspace(0.0, 1.0, frames)[:, None] * way
    lowest = min(
        float(pose_skeleton(clip.parents, clip.offsets, clip.local[k], clip.root[k])[1][:, 1].min())
        for k in np.unique(np.linspace(0, frames - 1, min(frames, 100)).astype(int))
    )
    clip.root[:] += np.array(config.position) - np.array([clip.root[0, 0], lowest, clip.root[0, 2]])


class BVH:
    """A skeleton moved by a BVH file; its end sites are joints named JOINT_end."""

    name: ClassVar[str] = "bvh"
    Config: ClassVar[type[BaseModel]] = BvhConfig

    def describe_motion(self, path: Path) -> Mapping[str, str]:
        """What a file says of itself, in words, by name. Raises BadInput for one that cannot be read."""
        found = read_bvh(path)
        names, dt = read_tree(found, path)[0], float(found.frame_time)
        ends = sum(name.endswith("_end") for name in names)
        facts = {"joints": f"{len(names) - ends}, and {ends} ends of bones", "frames": f"{found.frame_count}"}
        if STEPS[0] <= dt <= STEPS[1]:
            facts["lasts"] = f"{(found.frame_count - 1) * dt:.3g} s, at {1.0 / dt:.4g} Hz"
        return facts | {"root": names[0]}

    def prepare(self, config: BaseModel, files: Files) -> Mover:
        """Raises BadInput for a file that cannot be read and a part of it that is empty."""
        c = cast(BvhConfig, config)
        path = files.resolve(c.file)
        found = read_bvh(path)
        names, parents, offsets, rows = read_tree(found, path)
        dt = 1.0 / c.frame_rate if c.frame_rate else float(found.frame_time)
        if not STEPS[0] <= dt <= STEPS[1]:
            limit, remedy = f"{STEPS[0]:g} to {STEPS[1]:g} s", "give frame_rate"
            raise BadInput("no time between two frames", file=str(path), value=dt, limit=limit, remedy=remedy)
        part = cut_frames(c, found.frame_count, dt, path)
        upright = from_axis_angle(AXES[0], -0.5 * math.pi if c.up == "z" else 0.0)
        scale = c.scale or c.height / find_extent(parents, offsets, "xyz".index(c.up), path)
        _, quaternions = found.to_quat()
        local = np.zeros((part.stop - part.start, len(names), 4))
        local[:, :, 0] = 1.0
        local[:, rows >= 0] = quaternions[part][:, rows[rows >= 0]]
        local[:, 0] = multiply(upright, local[:, 0])
        root = turn(rotation_matrices(upright[None])[0], scale * found.root_pos[part])
        if not (np.abs(scale * offsets).max() <= FARTHEST and np.abs(root).max() <= FARTHEST):
            remedy = "check the file's numbers, or give a scale"
            raise BadInput("a body of no size", file=str(path), limit=f"{FARTHEST:g} m", remedy=remedy)
        loop = c.end == "loop" and root.shape[0] > 1
        blend = min(c.blend, 0.25 * (root.shape[0] - 1) * dt) if loop else 0.0
        clip = _Clip(parents, scale * offsets, local, root, dt, loop, blend, c.ramp, np.zeros(3))
        place_root(c, clip)
        if loop:
            clip.drift[:] = (clip.sample(clip.duration - blend)[1] - clip.root[0]) * np.array([1.0, 0.0, 1.0])
        return Mover(names, parents, clip.offsets, clip.pose)


def find_extent(parents: Int, offsets: Float, axis: int, path: Path) -> float:
    """Height of the skeleton at rest along `axis`, in the file's unit. Raises BadInput for 0."""
    extent = float(np.ptp(rest_positions(parents, offsets * (parents >= 0)[:, None])[:, axis]))
    if not extent > 0.0:
        raise BadInput("the skeleton at rest has no height", file=str(path), field="height", remedy="give a scale")
    return extent
