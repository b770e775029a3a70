"""Captured motion from a BVH file (Biovision hierarchy)."""

from __future__ import annotations

import io
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar, Literal, NamedTuple

import numpy as np
from pydantic import BaseModel, Field

from nuno_contact.colliders.body_parts import TRUNK, choose_height, find_arms, find_part, is_person
from nuno_contact.motions.rotations import AXES, from_axis_angle, multiply, pose_skeleton, rest_positions, slerp
from nuno_contact.quantities import Later, Point, Rate, Size, Span
from nuno_schemas.bodies import UNITS, fits_person, rotation_matrices, unit_of
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Float, Int
from nuno_schemas.plugin import Config, Files, Mover
from nuno_schemas.reading import read_as
from nuno_schemas.vectors import norm, turn

LARGEST_FILE = 256 * 2**20
STEPS = (1e-6, 1e4)
"""range of the time between two frames [s]"""
SLOWEST = 1.0
"""longest time between two frames of a capture [s]: a file with a longer one means frames a second"""
FARTHEST = 1e6
"""largest distance from the origin of a body, or of a bone's end from its joint [m]"""
FINEST = 1e-9
"""shortest unit of a file [m]: numbers that need a shorter one are wrong"""
CHANNELS = {axis + what for axis in "XYZ" for what in ("position", "rotation")}
STILL = 1e-4
"""Joints move against their parents if by more than this share of the longest bone: less is rounding."""
LOOKS = 100
"""number of poses among which the tallest is found"""
UNSCALED = "say how long one of the file's units is, such as scale: 1m"


class BvhConfig(Config):
    """A captured motion."""

    file: str = Field(description="the BVH file, beside the scene")
    height: Size = Field(
        default=1.7, description="of the body as it stands [m], which scales the file's unit; 1.7 for persons alone"
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
    up: Literal["y", "z"] | None = Field(
        default=None, description="vertical axis of the file; y unless given, and then the body must stand along it"
    )
    position: Point = Field(
        default=(0.0, 0.0, 0.0), description="where the body starts [m]: hips over x and z, its lowest point at y"
    )
    travel: bool = Field(
        default=True, description="keep its way over the ground; off: mean velocity taken out, it stays"
    )


@dataclass(frozen=True)
class Captured:
    """The content of a BVH file, lengths in its own unit; or a part of it, in metres.

    joints, parents  of j joints, parents before children; an end site is a joint named after its parent, JOINT_end
    offsets          (j, 3) from the parent: the file's, or the median of a joint's own positions
    turns            (m, j, 4) rotation of each joint against its parent in m frames
    places           (m, 1, 3) positions of the root, or (m, j, 3) of all joints from their parents where some move
    dt               time between two frames [s]
    """

    joints: tuple[str, ...]
    parents: Int
    offsets: Float
    turns: Float
    places: Float
    dt: float

    @property
    def duration(self) -> float:
        return float(len(self.places) - 1) * self.dt

    def pose(self, turns: Float, places: Float) -> tuple[Float, Float]:
        """Return world rotation (j, 4) and translation (j, 3) from the joints' turns (j, 4) and places (1 or j, 3)."""
        return pose_skeleton(self.parents, self.offsets if len(places) == 1 else places, turns, places[0])

    def at(self, frames: Int) -> Float:
        """Return the positions of the joints in frames (k,), shape (k, j, 3)."""
        return np.array([self.pose(self.turns[k], self.places[k])[1] for k in frames])

    def sample(self, t: float) -> tuple[Float, Float]:
        """Interpolate turns and places of the joints at time t [s] between the two nearest frames."""
        frames = len(self.places)
        at = min(max(t / self.dt, 0.0), frames - 1.0)
        k = min(int(at), max(frames - 2, 0))
        s = at - k
        if s == 0.0 or frames == 1:
            return self.turns[k], self.places[k]
        return slerp(self.turns[k], self.turns[k + 1], s), (1.0 - s) * self.places[k] + s * self.places[k + 1]


class _Joint(NamedTuple):
    name: str
    parent: int
    offset: list[float]
    channels: list[str]


def read_bvh(path: Path) -> Captured:
    """Read a BVH file. Raises BadInput for one that is empty, truncated, not BVH or not finite."""
    return read_as(path, "BVH", _read, LARGEST_FILE)


def _read(data: bytes) -> Captured:
    """Read a file's content. Raises ValueError."""
    from pybvh.rotations import euler_to_quat

    if not data:
        raise ValueError("it is empty")
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError:  # joint names of older programs; every byte is a letter of Latin-1
        text = data.decode("latin-1")
    head, *rows = re.split(r"(?m)^\s*MOTION\b", text, maxsplit=1)
    joints = _read_joints(head)
    frames, dt = _read_frames("".join(rows), sum(len(joint.channels) for joint in joints), 1 + head.count("\n"))
    offsets = np.array([joint.offset for joint in joints])
    if not np.isfinite(offsets).all():
        raise ValueError("offsets that are not finite numbers")
    turns, places = np.empty((len(frames), len(joints), 4)), np.tile(offsets, (len(frames), 1, 1))
    columns = iter(frames.T)
    for j, joint in enumerate(joints):
        own = {channel: next(columns) for channel in joint.channels}
        axes = [channel[0] for channel in own if channel.endswith("rotation")]
        # A joint does not turn about the axes that it does not name.
        axes += [axis for axis in "XYZ" if axis not in axes]
        angles = np.stack([own.get(f"{axis}rotation", np.zeros(len(frames))) for axis in axes], axis=1)
        turns[:, j] = euler_to_quat(np.deg2rad(angles), axes)
        given, added = places[:, j].copy(), places[:, j].copy()
        for axis, name in enumerate("XYZ"):
            column = own.get(f"{name}position")
            if column is not None:
                given[:, axis] = column
                added[:, axis] += column
        # Positions replace the offset; programs that count them from it are recognised by bones as long as that.
        far, near = (norm(np.median(place, axis=0) - offsets[j]) for place in (given, added))
        places[:, j] = added if j > 0 and near < far else given
    offsets[1:] = np.median(places[:, 1:], axis=0)
    if not (np.ptp(places[:, 1:], axis=0) > STILL * np.abs(offsets).max()).any():
        places = places[:, :1]
    parents = np.array([joint.parent for joint in joints], np.int32)
    return Captured(tuple(joint.name for joint in joints), parents, offsets, turns, places, dt)


def _read_joints(head: str) -> list[_Joint]:
    """Read the hierarchy. Raises ValueError."""
    joints, open_ = list[_Joint](), list[int]()
    for line, words in enumerate(map(str.split, head.splitlines()), 1):
        key, *values = words or ["{"]
        try:
            if key.upper() in ("ROOT", "JOINT", "END"):
                if joints and not open_:
                    remedy = "export each person, or prop, into a file of its own"
                    raise BadInput("a second ROOT", line=line, value=" ".join(values), remedy=remedy)
                parent = open_[-1] if joints else -1
                name = f"{joints[parent].name}_end" if key.upper() == "END" else " ".join(values)
                open_.append(len(joints))
                joints.append(_Joint(name, parent, [], []))
            elif key.upper() == "OFFSET":
                joints[open_[-1]].offset.extend(map(float, values))
            elif key.upper() == "CHANNELS":
                joints[open_[-1]].channels.extend(word.capitalize() for word in values[1:])
            elif key == "}":
                open_.pop()
            elif key.upper() not in ("{", "HIERARCHY"):
                raise IndexError
        except (IndexError, ValueError):
            raise ValueError(f"line {line}: {' '.join(words)[:60]}") from None
    for name, _, offset, channels in joints:
        if len(offset) != 3 or not set(channels) <= CHANNELS or len(set(channels)) < len(channels):
            raise ValueError(f"{name} has no offset of three numbers, or channels that are none or twice there")
        if sum(joint.name == name for joint in joints) > 1:
            raise ValueError(f"two joints have the same name, {name}")
    if not joints or open_:
        raise ValueError("its joints have no end" if joints else "it has no ROOT")
    return joints


def _read_frames(rows: str, columns: int, before: int) -> tuple[Float, float]:
    """Return (m, columns) values and the time step [s]; `before` is the line of MOTION. Raises ValueError."""
    found = re.match(r"\s*Frames:\s*(\d+)\s*Frame\s+Time:\s*(\S+)", rows, re.IGNORECASE)
    if found is None or not rows[found.end() :].strip():
        raise ValueError("after MOTION come Frames: and Frame Time: and their frames")
    text, before = rows[found.end() :], before + rows[: found.end()].count("\n")
    lines = [(n, len(words)) for n, words in enumerate(map(str.split, text.splitlines()), before) if words]
    if wrong := [(n, count) for n, count in lines if count != lines[0][1]]:
        raise ValueError(f"line {wrong[0][0]}: {wrong[0][1]} numbers, where the frames before have {lines[0][1]}")
    frames, dt = np.loadtxt(io.StringIO(text), ndmin=2), float(found[2])
    if not (finite := np.isfinite(frames).all(axis=1)).all():
        frame = int(np.argmin(finite))
        raise ValueError(f"line {lines[frame][0]}: frame {frame} has a number that is not finite")
    if frames.shape != (int(found[1]), columns):
        raise ValueError(f"{found[1]} frames of {columns} channels are announced, and {len(frames)} of "
                         f"{frames.shape[1]} follow")  # fmt: skip
    # Programs write 0.033333 for thirtieths of a second: a whole rate within 0.01 % is meant.
    rate = round(1.0 / dt) if STEPS[0] <= dt <= STEPS[1] else 0
    return frames, 1.0 / rate if rate and abs(1.0 / rate - dt) < 1e-4 * dt else dt


@dataclass(frozen=True)
class _Clip:
    """A motion in metres with its loop: see BvhConfig. `drift` (1, 3) is how far each loop carries it [m]."""

    motion: Captured
    loop: bool
    blend: float
    ramp: float
    drift: Float

    def pose(self, t: float) -> tuple[Float, Float]:
        """Return world rotation (j, 4) and translation (j, 3) at simulation time t [s].

        With a ramp T the clip runs at the rate t/T until t = T: half of T behind from then on. A loop of period D -
        blend shows the clip's last `blend` seconds while its first ones fade in, and goes on from where it got to.
        """
        t = max(t, 0.0)
        if self.ramp > 0.0:
            t = 0.5 * t * t / self.ramp if t < self.ramp else t - 0.5 * self.ramp
        period = self.motion.duration - self.blend
        if not self.loop or t <= period or period <= 0.0:
            local, places = self.motion.sample(t)
        else:
            turn, since = divmod(t, period)
            local, places = self.motion.sample(since)
            places = places + turn * self.drift
            if since < self.blend:
                s = since / self.blend
                s = s * s * (3.0 - 2.0 * s)
                old_local, old_places = self.motion.sample(period + since)
                local, old_places = slerp(old_local, local, s), old_places + (turn - 1.0) * self.drift
                places = (1.0 - s) * old_places + s * places
        return self.motion.pose(local, places)


def cut_frames(config: BvhConfig, frames: int, dt: float, path: Path) -> slice:
    """Return the frames between `start` and `stop`. Raises BadInput if that is less than one."""
    first = math.ceil(config.start / dt - 1e-9)
    last = frames - 1 if config.stop is None else min(frames - 1, math.floor(config.stop / dt + 1e-9))
    if first > last:
        limit, remedy = f"the file lasts {(frames - 1) * dt:g} s", "an earlier start or a later stop"
        raise BadInput("the part of the file has no frame", str(path), None, "start", config.start, limit, remedy)
    return slice(first, last + 1)


def place_root(config: BvhConfig, motion: Captured) -> None:
    """Remove the travel if it is not wanted, then move the motion to its start, in place."""
    root = motion.places[:, 0]
    frames = len(root)
    if not config.travel and frames > 1:
        way = (root[-1] - root[0]) * np.array([1.0, 0.0, 1.0])
        root -= np.linspace(0.0, 1.0, frames)[:, None] * way
    lowest = float(motion.at(_spread(frames))[..., 1].min())
    root += np.array(config.position) - np.array([root[0, 0], lowest, root[0, 2]])


def _spread(frames: int) -> Int:
    """Return the numbers of LOOKS frames at most, from the first to the last."""
    return np.unique(np.linspace(0, frames - 1, min(frames, LOOKS)).astype(int))


def find_stature(found: Captured, up: int) -> tuple[float, int]:
    """Return a person's height along the axis `up` (0, 1 or 2), in the file's unit, by the tallest pose or the skeleton
    at rest; and the axis along which the head lies from the root in most poses.
    """
    arm = find_arms(found.joints, found.parents)
    trunk = [j for j, name in enumerate(found.joints) if not arm[j] and find_part(name) in TRUNK]
    poses = found.at(_spread(len(found.turns)))
    ways = poses[:, trunk[-1]] - poses[:, 0] if trunk else np.eye(3)[[up]]
    rest = rest_positions(found.parents, found.offsets * (found.parents >= 0)[:, None])
    height = choose_height(*(float(np.ptp(x[..., ~arm, up], axis=-1).max()) for x in (rest, poses)))
    return height, int(np.argmax(np.abs(np.median(ways, axis=0))))


class BVH:
    """A skeleton moved by a BVH file; its end sites are joints named JOINT_end."""

    name: ClassVar[str] = "bvh"
    Config: ClassVar[type[BaseModel]] = BvhConfig

    def describe_motion(self, path: Path) -> Mapping[str, str]:
        """Describe a file's content, by name. Raises BadInput for one that cannot be read."""
        found = read_bvh(path)
        ends, frames = sum(name.endswith("_end") for name in found.joints), len(found.turns)
        facts = {"joints": f"{len(found.joints) - ends}, and {ends} ends of bones", "frames": f"{frames}"}
        if STEPS[0] <= found.dt <= SLOWEST:
            facts["lasts"] = f"{found.duration:.3g} s, at {1.0 / found.dt:.4g} Hz"
        if not is_person(found.joints):
            size = np.ptp(found.at(np.zeros(1, int))[0], axis=0)
            return facts | {"size": "{:.4g} x {:.4g} x {:.4g} units".format(*size), "root": found.joints[0]}
        axis = find_stature(found, 1)[1]
        tall = find_stature(found, axis)[0]
        unit = unit_of(tall)
        facts["stands"] = f"along {'xyz'[axis]}, {tall:.4g} units high" + (f": {unit} each?" if unit else "")
        return facts | {"root": found.joints[0]}

    def prepare(self, config: BvhConfig, files: Files) -> Mover:
        """Read the motion. Raises BadInput for a file that cannot be read, a lying body, no size, and an empty part."""
        path = files.resolve(config.file)
        found = read_bvh(path)
        dt = 1.0 / config.frame_rate if config.frame_rate else found.dt
        if not STEPS[0] <= dt <= (STEPS[1] if config.frame_rate else SLOWEST):
            limit, remedy = f"{STEPS[0]:g} to {SLOWEST:g} s", "give frame_rate"
            if dt > SLOWEST:
                remedy = f"frame_rate: {dt:g} Hz if that is meant; if not, frame_rate: {1.0 / dt:.6g} Hz keeps it"
            raise BadInput("no time between two frames", str(path), field="Frame Time", value=dt, limit=limit,
                           remedy=remedy)  # fmt: skip
        part = cut_frames(config, len(found.turns), dt, path)
        up = "xyz".index(config.up or "y")
        height, along = find_stature(found, up)
        if config.up is None and along != up:
            axis = "xyz"[along]
            remedy = ("up: z where z is the file's vertical axis, " if axis == "z" else "") + "up: y where it does lie"
            raise BadInput("the body lies", str(path), field="up", value=f"from the root the head is along {axis}",
                           limit="y points up unless the scene says otherwise", remedy=remedy)  # fmt: skip
        if config.scale is None and "height" not in config.model_fields_set and not is_person(found.joints):
            raise BadInput("no joints are named after a trunk and legs: the size is unknown", str(path), field="scale",
                           remedy=f"height: {config.height:g} m if that is a person's; if not, {UNSCALED}")  # fmt: skip
        if config.scale is None and not height > 0.0:
            problem, value = "the skeleton has no height", config.height
            raise BadInput(problem, str(path), field="height", value=value, remedy=UNSCALED)
        notes = _size_notes(config, height) if along == up and is_person(found.joints) else ()
        upright = from_axis_angle(AXES[0], -0.5 * math.pi if config.up == "z" else 0.0)
        scale = config.scale or config.height / height
        local = found.turns[part]
        local[:, 0] = multiply(upright, local[:, 0])
        places = scale * found.places[part]
        places[:, 0] = turn(rotation_matrices(upright[None])[0], places[:, 0])
        farthest = max(np.abs(max(scale, FINEST) * found.offsets).max(), np.abs(places).max())
        if not farthest <= FARTHEST:
            remedy = "check the file's numbers, or give a scale"
            raise BadInput("a body of no size", file=str(path), limit=f"{FARTHEST:g} m", remedy=remedy)
        loop = config.end == "loop" and len(places) > 1
        blend = min(config.blend, 0.25 * (len(places) - 1) * dt) if loop else 0.0
        motion = replace(found, offsets=scale * found.offsets, turns=local, places=places, dt=dt)
        place_root(config, motion)
        way = (motion.sample(motion.duration - blend)[1][:1] - motion.places[0, :1]) * np.array([1.0, 0.0, 1.0])
        clip = _Clip(motion, loop, blend, config.ramp, way)
        return Mover(found.joints, found.parents, motion.offsets, clip.pose, notes=notes)


def _size_notes(config: BvhConfig, height: float) -> tuple[str, ...]:
    """Note a scale by which a standing person, `height` of the file's units high, has no person's size."""
    if config.scale is None or fits_person(config.scale * height):
        return ()
    unit = next((unit for unit, length in UNITS.items() if fits_person(length * height)), f"{1.7 / height:.3g}m")
    size = f"by its scale the body is {config.scale * height:.3g} m high, which no standing person is"
    return (f"{size}; with scale: {unit} it is one",)
