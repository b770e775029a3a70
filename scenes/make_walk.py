"""Make walk.bvh, one cycle of level walking: python scenes/make_walk.py

No capture: the pelvis and the soles are prescribed, and hips, knees and ankles follow from them by
the law of cosines, so that a standing foot stays where it is. The prescribed curves are

- stance 62 % of the cycle, heel strike with the toes 14 degrees up, foot flat from 12 to 38 %, heel
  rise over the ball of the foot until toe-off (Perry and Burnfield, Gait Analysis, 2010, ch. 2-4:
  the heel, ankle and forefoot rockers);
- pelvis rise 3.6 cm and sway 4 cm from end to end, highest and furthest over the standing leg in
  mid-stance, lowest in double support; turn about the vertical and obliquity 5 and 4 degrees to
  either side (Murray, Drought and Kory, Walking patterns of normal men, 1964; Saunders, Inman and
  Eberhart, The major determinants in normal and pathological gait, 1953);
- shoulders turn against the pelvis and arms swing against the legs, more back than forth, elbows
  bend 15 to 35 degrees (Murray, Sepic and Barnard, Patterns of sagittal rotation of the upper
  limbs in walking, 1967).

What follows is to be compared: in normal gait the hip goes through about 40 degrees, the knee bends
about 15 in early stance and 60 in swing, and the ankle goes from 10 up to 20 down (Winter,
Biomechanics and Motor Control of Human Movement, 2009, ch. 3).

Lengths are fractions of body height, those of the hula dancer, in centimetres in the file. y is up,
the walker goes along +z, the left side is at x > 0. Phase 0 is the left heel strike; the file
starts at left mid-stance, where the legs are closest and a skirt can be put on. Its last frame
is its first one, a stride further.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

PATH = Path(__file__).with_name("walk.bvh")
HEIGHT = 165.0
RATE = 40
FRAMES = 45
STRIDE = 0.74 * HEIGHT
START = 0.30
OVER = 0.24
"""Phases of left mid-stance, and of the pelvis over the left ankle (a little earlier: heels reach
less far than toes)."""
FLAT, RISE, OFF = 0.12, 0.38, 0.62
"""Phases of foot flat, heel rise and toe-off."""
HEEL_UP, TOES_UP = math.radians(-58.0), math.radians(14.0)
LIFT = 2.0
"""What the swinging ankle is raised by, so that the toes clear the floor [cm]."""
PELVIS, DROP = 0.5305 * HEIGHT, 0.03 * HEIGHT
"""Mean height of the pelvis, and how far below it the hip joints lie [cm]."""
HALF_STEP_WIDTH = 0.033 * HEIGHT
ANKLE, BALL = 0.045 * HEIGHT, 0.02 * HEIGHT
"""Heights of the joints over the sole of a flat foot [cm]."""
TO_BALL, TO_HEEL = 0.075 * HEIGHT, 0.03 * HEIGHT
THIGH, SHIN = 0.235 * HEIGHT, 0.24 * HEIGHT

SPINE = [
    ("Hips", "", (0.0, 0.55, 0.0)),
    ("Spine", "Hips", (0.0, 0.08, 0.0)),
    ("Chest", "Spine", (0.0, 0.10, 0.0)),
    ("Neck", "Chest", (0.0, 0.095, 0.0)),
    ("Head", "Neck", (0.0, 0.065, 0.01)),
    ("", "Head", (0.0, 0.095, 0.0)),
]
SIDE = [
    ("Arm", "Chest", (0.105, 0.065, 0.0)),
    ("ForeArm", "Arm", (0.0, -0.165, 0.0)),
    ("Hand", "ForeArm", (0.0, -0.145, 0.0)),
    ("", "Hand", (0.0, -0.09, 0.0)),
    ("UpLeg", "Hips", (0.052, -0.03, 0.0)),
    ("Leg", "UpLeg", (0.0, -0.235, 0.0)),
    ("Foot", "Leg", (0.0, -0.24, 0.0)),
    ("ToeBase", "Foot", (0.0, -0.025, 0.075)),
    ("", "ToeBase", (0.0, 0.0, 0.04)),
]


def build_skeleton() -> list[tuple[str, str, Array]]:
    """(name, parent, offset [cm]) of every joint; an end site has no name."""
    rows = [(name, parent, np.array(offset)) for name, parent, offset in SPINE]
    for side, sign in (("Left", 1.0), ("Right", -1.0)):
        for name, parent, (x, y, z) in SIDE:
            above = parent if parent in ("Chest", "Hips") else side + parent
            rows.append((name and side + name, above, np.array([sign * x, y, z])))
    return [(name, parent, HEIGHT * offset) for name, parent, offset in rows]


def turn(axis: int, angle: float) -> Array:
    """(3, 3) rotation about x, y or z."""
    c, s = math.cos(angle), math.sin(angle)
    matrix = np.eye(3)
    i, j = (axis + 1) % 3, (axis + 2) % 3
    matrix[i, i] = matrix[j, j] = c
    matrix[i, j], matrix[j, i] = -s, s
    return matrix


def place_sole(phase: float) -> tuple[float, float, float]:
    """Ankle along the way and up [cm] from the middle of its flat foot, and the foot's pitch (toes
    up > 0), in stance. The foot rolls over its heel, stands, and rolls over its ball.
    """
    if phase < FLAT:
        pitch = TOES_UP * (1.0 - phase / FLAT) ** 2
        y, z = turn_in_plane(ANKLE, TO_HEEL, pitch)
        return z - TO_HEEL, y, pitch
    if phase < RISE:
        return 0.0, ANKLE, 0.0
    pitch = HEEL_UP * ((phase - RISE) / (OFF - RISE)) ** 2
    y, z = turn_in_plane(ANKLE - BALL, -TO_BALL, pitch)
    return TO_BALL + z, BALL + y, pitch


def turn_in_plane(y: float, z: float, pitch: float) -> tuple[float, float]:
    """The point (y, z), turned so that +z goes up by `pitch`."""
    c, s = math.cos(pitch), math.sin(pitch)
    return c * y + s * z, c * z - s * y


def bridge(first: Array, speed: Array, last: Array, last_speed: Array, s: float) -> Array:
    """Cubic from `first` to `last` as s goes from 0 to 1, with the given slopes at its ends."""
    a, b = s * s * (3.0 - 2.0 * s), s * (1.0 - s)
    moved: Array = (1.0 - a) * first + a * last + b * ((1.0 - s) * speed - s * last_speed)
    return moved


def place_foot(phase: float) -> tuple[float, float, float, float]:
    """Ankle along the way and up [cm], pitch of the foot and of the toes, at any phase.

    Along the way the foot stands at 0 and goes a stride forward in every swing.
    """
    turns = math.floor(phase)
    since = phase - turns
    if since < OFF:
        along, up, pitch = place_sole(since)
        return along + turns * STRIDE, up, pitch, 0.0 if since >= RISE else pitch
    swing, h = 1.0 - OFF, 1e-5
    first, last = np.array(place_sole(OFF)), np.array(place_sole(0.0))
    speed = (first - np.array(place_sole(OFF - h))) / h * swing
    last_speed = (np.array(place_sole(h)) - last) / h * swing
    last[0] += STRIDE
    s = (since - OFF) / swing
    along, up, pitch = bridge(first, speed, last, last_speed, s)
    bend = -HEEL_UP * (1.0 - s) ** 2 * (1.0 + 2.0 * s)
    up += 16.0 * LIFT * (s * (1.0 - s)) ** 2
    return float(along) + turns * STRIDE, float(up), float(pitch), float(pitch) + bend


def turn_pelvis(phase: float) -> Array:
    """(3, 3): the side that swings goes forward and hangs lower."""
    obliquity = math.radians(4.0) * math.sin(2.0 * math.pi * (phase + 0.04))
    return turn(1, math.radians(-5.0) * math.cos(2.0 * math.pi * phase)) @ turn(2, obliquity)


def place_pelvis(phase: float) -> Array:
    """(3,) [cm]: over the standing foot, highest in mid-stance."""
    sway = 2.0 * math.cos(2.0 * math.pi * (phase - START))
    rise = 1.8 * math.cos(4.0 * math.pi * (phase - START))
    return np.array([sway, PELVIS + rise, STRIDE * (phase - OVER)])


def bend_leg(hip: Array, ankle: Array, front: Array) -> tuple[Array, Array]:
    """World rotations (3, 3) of thigh and shin. Raises ValueError where the leg is too short."""
    line = ankle - hip
    far = float(np.linalg.norm(line))
    if far >= THIGH + SHIN:
        raise ValueError(f"hip and ankle are {far:.2f} cm apart, the leg is {THIGH + SHIN:.2f} cm long")
    unit = line / far
    along = (THIGH**2 - SHIN**2 + far**2) / (2.0 * far)
    out = front - (front @ unit) * unit
    knee = hip + along * unit + math.sqrt(THIGH**2 - along**2) * out / np.linalg.norm(out)
    return aim(knee - hip, front), aim(ankle - knee, front)


def aim(direction: Array, front: Array) -> Array:
    """(3, 3) rotation that turns -y to `direction` and keeps z as near to `front` as that allows."""
    y = -direction / np.linalg.norm(direction)
    z = front - (front @ y) * y
    z /= np.linalg.norm(z)
    return np.stack([np.cross(y, z), y, z], axis=1)


def pose_legs(phase: float, pelvis: Array, middle: Array) -> dict[str, Array]:
    """Rotations of thighs, shins, feet and toes against their parents."""
    found = {}
    for side, sign, shift in (("Left", 1.0, 0.0), ("Right", -1.0, 0.5)):
        out = turn(1, sign * math.radians(6.0))
        along, up, pitch, toes = place_foot(phase - shift)
        ankle = np.array([sign * HALF_STEP_WIDTH, up, along + shift * STRIDE])
        hip = middle + pelvis @ np.array([sign * 0.052 * HEIGHT, -DROP, 0.0])
        thigh, shin = bend_leg(hip, ankle, out[:, 2])
        foot = out @ turn(0, -pitch)
        found[f"{side}UpLeg"] = pelvis.T @ thigh
        found[f"{side}Leg"] = thigh.T @ shin
        found[f"{side}Foot"] = shin.T @ foot
        found[f"{side}ToeBase"] = turn(0, pitch - toes)
    return found


def pose_trunk(phase: float, pelvis: Array) -> dict[str, Array]:
    """Rotations of back, head and arms against their parents: the head looks ahead."""
    shoulders = turn(1, math.radians(5.0) * math.cos(2.0 * math.pi * phase)) @ turn(0, math.radians(2.0))
    half = turn(1, math.radians(1.0) * math.cos(2.0 * math.pi * phase)) @ turn(0, math.radians(3.0))
    found = {"Hips": pelvis, "Spine": pelvis.T @ half, "Chest": half.T @ shoulders, "Neck": shoulders.T}
    for side, sign in (("Left", 1.0), ("Right", -1.0)):
        swing = sign * math.cos(2.0 * math.pi * phase)
        found[f"{side}Arm"] = turn(2, sign * math.radians(11.0)) @ turn(0, math.radians(4.0 + 18.0 * swing))
        found[f"{side}ForeArm"] = turn(0, math.radians(-25.0 + 10.0 * swing))
    return found


def to_euler(matrix: Array) -> tuple[float, float, float]:
    """Angles [degrees] about z, y and x of R = Rz Ry Rx, the order of the file's channels."""
    z = math.atan2(matrix[1, 0], matrix[0, 0])
    y = math.asin(max(-1.0, min(1.0, -matrix[2, 0])))
    x = math.atan2(matrix[2, 1], matrix[2, 2])
    return math.degrees(z), math.degrees(y), math.degrees(x)


def make_frame(phase: float, joints: list[str]) -> list[float]:
    """Place of the hips [cm] and angles [degrees] of all joints."""
    pelvis, middle = turn_pelvis(phase), place_pelvis(phase)
    turns = pose_legs(phase, pelvis, middle) | pose_trunk(phase, pelvis)
    values = [float(value) for value in middle]
    for joint in joints:
        values += to_euler(turns.get(joint, np.eye(3)))
    return values


def write_hierarchy(rows: list[tuple[str, str, Array]], joint: str, depth: int) -> list[str]:
    """Lines of a joint and what hangs on it, and the order in which its joints come."""
    offset = next(offset for name, _, offset in rows if name == joint)
    tab, inner = "  " * depth, "  " * (depth + 1)
    place = "Xposition Yposition Zposition " if depth == 0 else ""
    lines = [f"{tab}{'ROOT' if depth == 0 else 'JOINT'} {joint}", f"{tab}{{", f"{inner}OFFSET {in_columns(offset)}"]
    lines.append(f"{inner}CHANNELS {6 if depth == 0 else 3} {place}Zrotation Yrotation Xrotation")
    for name, parent, end in rows:
        if parent == joint and name:
            lines += write_hierarchy(rows, name, depth + 1)
        elif parent == joint:
            lines += [f"{inner}End Site", f"{inner}{{", f"{inner}  OFFSET {in_columns(end)}", f"{inner}}}"]
    return [*lines, f"{tab}}}"]


def in_columns(values: Array | list[float]) -> str:
    """Numbers to a tenth of a micrometre; + 0.0 takes the sign off a zero."""
    return " ".join(f"{round(float(value), 5) + 0.0:.5f}" for value in values)


def make_walk() -> str:
    """The whole file."""
    hierarchy = write_hierarchy(build_skeleton(), "Hips", 0)
    joints = [line.split()[1] for line in hierarchy if line.split()[0] in ("ROOT", "JOINT")]
    frames = [in_columns(make_frame(START + k / (FRAMES - 1), joints)) for k in range(FRAMES)]
    motion = ["MOTION", f"Frames: {FRAMES}", f"Frame Time: {1.0 / RATE:g}"]
    return "\n".join(["HIERARCHY", *hierarchy, *motion, *frames, ""])


if __name__ == "__main__":
    PATH.write_text(make_walk())
