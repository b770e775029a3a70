"""BVH: joint positions against forward kinematics of the file's own numbers, written anew."""

import re
from pathlib import Path

import numpy as np
import pybvh
import pytest

from nuno_contact.colliders.skeleton import Skeleton, SkeletonConfig
from nuno_contact.motions.bvh import BVH, BvhConfig, read_bvh
from nuno_contact.motions.topic import Topic, TopicConfig
from nuno_schemas.bodies import rotation_matrices
from nuno_schemas.errors import BadInput

WALK = Path(__file__).parents[3] / "shared" / "data" / "cmu_12_01_walk.bvh"
SHIPPED = Path(__file__).parents[2] / "scenes" / "walk.bvh"

TINY = """HIERARCHY
ROOT Hips
{
  OFFSET 0.5 0.0 0.0
  CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation
  JOINT Spine
  {
    OFFSET 0.0 2.0 0.0
    CHANNELS 3 Yrotation Zrotation Xrotation
    End Site
    {
      OFFSET 0.0 1.0 0.5
    }
  }
  JOINT LeftUpLeg
  {
    OFFSET 0.3 -1.0 0.0
    CHANNELS 3 Xrotation Yrotation Zrotation
    End Site
    {
      OFFSET 0.0 -3.0 0.0
    }
  }
}
MOTION
Frames: 5
Frame Time: 0.25
0 4 0   0 0 0     0 0 0      0 0 0
1 4 0   10 20 30  5 10 15    40 0 10
2 4.5 1  20 30 40  10 20 30   30 5 20
3 4 1   30 20 50  15 30 45   20 10 30
4 4 2   40 10 60  20 40 60   10 15 40
"""


class Anywhere:
    def resolve(self, name):
        return Path(name)


def prepare(path, **config):
    return BVH().prepare(BvhConfig(file=str(path), **config), Anywhere())


@pytest.fixture
def tiny(tmp_path):
    path = tmp_path / "tiny.bvh"
    path.write_text(TINY)
    return path


def parse(text):
    """Nodes (name, parent, offset, channels) and frames, read token by token."""
    tokens = iter(text.split())
    nodes, stack, name = [], [], ""
    for token in tokens:
        if token in ("ROOT", "JOINT"):
            name = next(tokens)
        elif token == "End":
            name = nodes[stack[-1]][0] + "_end"
            next(tokens)
        elif token == "{":
            nodes.append([name, stack[-1] if stack else -1, None, []])
            stack.append(len(nodes) - 1)
        elif token == "}":
            stack.pop()
        elif token == "OFFSET":
            nodes[stack[-1]][2] = np.array([float(next(tokens)) for _ in range(3)])
        elif token == "CHANNELS":
            nodes[stack[-1]][3] = [next(tokens) for _ in range(int(next(tokens)))]
        elif token == "Frames:":
            number = int(next(tokens))
        elif token == "Time:":
            break
    float(next(tokens))
    return nodes, np.array([float(token) for token in tokens]).reshape(number, -1)


def turn(axis, degrees):
    """4x4 turn about a coordinate axis."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    m, (i, j) = np.eye(4), {"X": (1, 2), "Y": (2, 0), "Z": (0, 1)}[axis]
    m[i, i], m[i, j], m[j, i], m[j, j] = c, -s, s, c
    return m


def kinematics(nodes, row):
    """World positions of all nodes: homogeneous matrices, channels applied in the file's order.
    Channels of a position replace the offset.
    """
    values, world, found = iter(row), [], []
    for _, parent, offset, channels in nodes:
        local = np.eye(4)
        local[:3, 3] = 0.0 if parent < 0 else offset
        for channel in channels:
            value = next(values)
            if channel.endswith("position"):
                local["XYZ".index(channel[0]), 3] = value
            else:
                local = local @ turn(channel[0], value)
        world.append(local if parent < 0 else world[parent] @ local)
        found.append(world[-1][:3, 3])
    return np.array(found)


def assert_shape_agrees(path, frame_time, frames):
    """Joint positions relative to the root agree in shape with the independent calculation."""
    nodes, motion = parse(path.read_text())
    mover = prepare(path, scale=1.0)
    assert mover.joints == tuple(name for name, *_ in nodes)
    shift = None
    for k in frames:
        expected, found = kinematics(nodes, motion[k]), mover.pose(k * frame_time)[1]
        shift = found[0] - expected[0] if shift is None else shift
        np.testing.assert_allclose(found, expected + shift, atol=1e-9)
    return mover


def test_tiny_file_agrees_with_forward_kinematics(tiny):
    assert_shape_agrees(tiny, 0.25, range(5))


@pytest.mark.skipif(not WALK.exists(), reason="shared data cmu_12_01_walk.bvh is not there")
def test_captured_walk_agrees_and_bones_keep_their_length():
    mover = assert_shape_agrees(WALK, 1.0 / 120.0, range(0, 524, 40))
    assert sum(not joint.endswith("_end") for joint in mover.joints) == 31
    lengths = np.linalg.norm(mover.offsets[1:], axis=1)
    for t in np.linspace(0.0, 4.3, 23):
        x = mover.pose(t)[1]
        np.testing.assert_allclose(
            np.linalg.norm(x[1:] - x[mover.parents[1:]], axis=1), lengths, rtol=1e-12, atol=1e-12
        )


def test_shipped_walk_agrees_with_the_library_in_every_frame():
    """Every joint and end site of every frame, in metres, where pybvh's own kinematics puts it."""
    found = pybvh.read_bvh_file(SHIPPED, world_up="+y")
    expected = found.node_positions(centered="world")
    assert expected.shape[0] == found.frame_count > 40
    mover = prepare(SHIPPED, scale=0.01)
    places = [found.node_index[node.name] for node in found.nodes]
    x = np.array([mover.pose(k * found.frame_time)[1] for k in range(found.frame_count)])
    shift = x[0, 0] - 0.01 * expected[0, places[0]]
    np.testing.assert_allclose(x, 0.01 * expected[:, places] + shift, atol=1e-12)
    assert shift[[0, 2]] == pytest.approx(-0.01 * expected[0, places[0], [0, 2]], abs=1e-12)
    assert_shape_agrees(SHIPPED, found.frame_time, range(found.frame_count))


def test_body_is_scaled_and_put_where_the_scene_says(tiny):
    mover = prepare(tiny, height="1.75 m", position=(1, 2, 3))
    rest = np.ptp(np.stack([[0, 0, 0], [0, 3, 0.5], [0.3, -4, 0]]), axis=0)[1]
    x = np.array([mover.pose(t)[1] for t in (0.0, 0.25, 0.5, 0.75, 1.0)])
    np.testing.assert_allclose(x[0, 0, [0, 2]], [1.0, 3.0], atol=1e-15)
    assert x[:, :, 1].min() == pytest.approx(2.0, abs=1e-12)
    assert np.linalg.norm(x[2, 1] - x[2, 0]) == pytest.approx(2.0 * 1.75 / rest, rel=1e-12)


def test_travel_can_be_taken_out(tiny):
    kept, still = prepare(tiny, scale=1), prepare(tiny, scale=1, travel=False)
    np.testing.assert_allclose((kept.pose(1.0)[1] - kept.pose(0.0)[1])[0], [4.0, 0.0, 2.0], atol=1e-12)
    np.testing.assert_allclose((still.pose(1.0)[1] - still.pose(0.0)[1])[0], 0.0, atol=1e-12)


def test_z_up_files_are_set_upright(tiny, tmp_path):
    """The same motion written with z up (x, y, z -> x, -z, y) gives the same body."""
    other = tmp_path / "z.bvh"
    text = TINY.replace("OFFSET 0.0 2.0 0.0", "OFFSET 0.0 0.0 2.0").replace("OFFSET 0.0 1.0 0.5", "OFFSET 0.0 -0.5 1.0")
    text = text.replace("OFFSET 0.3 -1.0 0.0", "OFFSET 0.3 0.0 -1.0").replace(
        "OFFSET 0.0 -3.0 0.0", "OFFSET 0.0 0.0 -3.0"
    )
    head, rows = text.split("Frame Time: 0.25\n")
    changed = [f"{x} {-float(z)} {y} {rest}" for x, y, z, rest in (row.split(maxsplit=3) for row in rows.splitlines())]
    head = head.replace("Zrotation Xrotation Yrotation", "Yrotation Xrotation Zrotation")
    head = head.replace("Yrotation Zrotation Xrotation", "Zrotation Yrotation Xrotation")
    head = head.replace("CHANNELS 3 Xrotation Yrotation Zrotation", "CHANNELS 3 Xrotation Zrotation Yrotation")
    signs = np.array([1, 1, 1, -1, 1, 1, 1, -1, 1, 1, 1, -1])  # about y here is about -z there
    values = np.array([[float(token) for token in row.split()] for row in changed]) * signs
    other.write_text(head + "Frame Time: 0.25\n" + "\n".join(" ".join(map(str, row)) for row in values))
    expected, found = prepare(tiny, height=1.7), prepare(other, height=1.7, up="z")
    for t in (0.0, 0.3, 0.75):
        np.testing.assert_allclose(found.pose(t)[1], expected.pose(t)[1], atol=1e-12)


def test_time_range_frame_rate_and_hold(tiny):
    whole, part, fast = prepare(tiny, scale=1), prepare(tiny, scale=1, start=0.25, stop="750 ms"), None
    fast = prepare(tiny, scale=1, frame_rate="40 Hz")
    for t in (0.0, 0.25, 0.4, 0.5):
        shape = part.pose(t)[1] - part.pose(t)[1][0]
        np.testing.assert_allclose(shape, whole.pose(t + 0.25)[1] - whole.pose(t + 0.25)[1][0], atol=1e-12)
    np.testing.assert_array_equal(part.pose(0.5)[1], part.pose(7.0)[1])
    np.testing.assert_allclose(fast.pose(0.05)[1], whole.pose(0.5)[1], atol=1e-12)


@pytest.mark.parametrize("travel", [True, False])
def test_a_loop_goes_on_without_a_jump(tiny, travel):
    mover, h = prepare(tiny, scale=1, end="loop", travel=travel), 1e-4
    period = 1.0 - 0.25
    for seam in (period, period + 0.25, 2.0 * period, 3.0 * period):
        x = np.array([mover.pose(t)[1] for t in seam + h * np.arange(-20, 20)])
        assert np.abs(np.diff(x, axis=0)).max() < 40.0 * h  # the fastest bone of this file: no jump
    there, later = mover.pose(1.2)[1], mover.pose(1.2 + 2 * period)[1]
    way = (later - there)[0]
    np.testing.assert_allclose(later - there, np.tile(way, (len(there), 1)), atol=1e-12)
    assert way[1] == pytest.approx(0.0, abs=1e-12)


def test_ramp_starts_from_rest_and_then_lags_by_half_of_it(tiny):
    plain, ramped = prepare(tiny, scale=1), prepare(tiny, scale=1, ramp="0.4 s")
    assert np.abs(ramped.pose(1e-4)[1] - ramped.pose(0.0)[1]).max() < 1e-5
    for t in (0.5, 0.9):
        np.testing.assert_allclose(ramped.pose(t)[1], plain.pose(t - 0.2)[1], atol=1e-12)


def test_a_fault_of_a_frame_or_of_the_joints_is_refused_with_its_line(tmp_path):
    """A number that is missing, one that is none, and a second person, in their lines."""
    lines = TINY.rstrip().splitlines()
    motion = next(n for n, line in enumerate(lines) if line.startswith("MOTION"))
    short, broken = lines[-1].rsplit(maxsplit=1)[0], f"{lines[-1].rsplit(maxsplit=1)[0]} nan"
    for text, line, words in (
        ([*lines[:-1], short], len(lines), "numbers, where the frames before have"),
        ([*lines[:-1], broken], len(lines), "not finite"),
        ([*lines[:motion], "ROOT prop", "{", "OFFSET 0 0 0", "}", *lines[motion:]], motion + 1, "a second ROOT"),
    ):
        (tmp_path / "it.bvh").write_text("\n".join(text))
        with pytest.raises(BadInput, match=words) as refused:
            read_bvh(tmp_path / "it.bvh")
        assert refused.value.line == line or f"line {line}:" in refused.value.problem


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "empty"),
        (TINY[:400], "read as BVH"),
        (TINY[:-60], "read as BVH"),
        (TINY.replace("4.5", "nan"), "not finite"),
        (TINY.replace("OFFSET 0.0 2.0 0.0", "OFFSET 0.0 inf 0.0"), "not finite"),
        ("not a motion\n", "read as BVH"),
        (TINY.replace("JOINT LeftUpLeg", "JOINT Spine"), "same name"),
        (TINY.replace("Frame Time: 0.25", "Frame Time: -1"), "no time between two frames"),
    ],
    ids=["empty", "no motion", "truncated", "nan", "inf", "text", "twice", "backwards"],
)
def test_a_bad_file_is_refused_by_name(tmp_path, text, words):
    path = tmp_path / "bad.bvh"
    path.write_text(text)
    with pytest.raises(BadInput, match=words) as caught:
        prepare(path, scale=1)
    assert "bad.bvh" in str(caught.value)


@pytest.mark.parametrize("number", ["OFFSET 0.5", "Time: 0.25", "2 4.5 1"])
def test_a_decimal_comma_is_refused_with_its_line(tmp_path, number):
    path = tmp_path / "commas.bvh"
    path.write_text(TINY.replace(number, number.replace(".", ",")))
    with pytest.raises(BadInput, match="cannot be read as BVH") as caught:
        prepare(path)
    point = next(word for word in number.split() if "." in word)
    assert caught.value.remedy == f"write {point}: numbers have a decimal point"
    assert caught.value.line == 1 + next(n for n, line in enumerate(TINY.splitlines()) if number in line)


def test_a_part_without_frames_is_refused(tiny):
    with pytest.raises(BadInput, match="no frame"):
        prepare(tiny, start=3.0)


STANDING = """HIERARCHY
ROOT Hips
{
  OFFSET 0 0 0
  CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation
  JOINT Spine
  {
    OFFSET 0 0.2 0
    CHANNELS 3 Zrotation Xrotation Yrotation
    JOINT Head
    {
      OFFSET 0 0.4 0
      CHANNELS 3 Zrotation Xrotation Yrotation
      End Site
      {
        OFFSET 0 0.2 0
      }
    }
  }
  JOINT LeftUpLeg
  {
    OFFSET 0.1 0 0
    CHANNELS 3 Zrotation Xrotation Yrotation
    JOINT LeftLeg
    {
      OFFSET 0 -0.5 0
      CHANNELS 3 Zrotation Xrotation Yrotation
      End Site
      {
        OFFSET 0 -0.4 0
      }
    }
  }
}
MOTION
Frames: 2
Frame Time: 0.04
0 0.9 0  0 0 0  0 0 0  0 0 0  0 0 0  0 0 0
0 0.9 0  0 0 0  0 0 0  0 0 0  0 0 0  9 0 0
"""
"""1.7 units from the feet to the top."""


def written(folder, text, name="it.bvh", encoding="utf-8"):
    path = folder / name
    path.write_text(text, encoding=encoding)
    return path


def lying(text):
    """The same poses of a skeleton whose bones all run along x at rest: turns about z undo that."""
    for old, new in (("0 0.2 0", "0.2 0 0"), ("0 0.4 0", "0.4 0 0"), ("0 -0.5 0", "0.5 0 0"), ("0 -0.4 0", "0.4 0 0")):
        text = text.replace(f"OFFSET {old}", f"OFFSET {new}")
    return text.replace("0 0.9 0  0 0 0  0 0 0  0 0 0  0 0 0", "0 0.9 0  90 0 0  0 0 0  0 0 0  -180 0 0").replace(
        "OFFSET 0.1 0 0", "OFFSET 0 -0.1 0"
    )


def test_a_person_is_as_tall_as_the_scene_says_however_its_skeleton_rests(tmp_path):
    """And its capsules are as thick."""
    standing = prepare(written(tmp_path, STANDING), height=1.7)
    lies = prepare(written(tmp_path, lying(STANDING)), height=1.7)
    for t in (0.0, 0.03):
        np.testing.assert_allclose(lies.pose(t)[1], standing.pose(t)[1], atol=1e-12)
    assert np.ptp(lies.pose(0.0)[1][:, 1]) == pytest.approx(1.7, rel=1e-12)
    radii = [Skeleton().build(SkeletonConfig(), mover, Anywhere()).radius for mover in (standing, lies)]
    np.testing.assert_allclose(radii[1], radii[0], rtol=1e-12)


def test_raised_arms_do_not_make_a_person_taller(tmp_path):
    arms = """  JOINT LeftArm
  {
    OFFSET 0.2 0.5 0
    CHANNELS 3 Zrotation Xrotation Yrotation
    End Site
    {
      OFFSET 0.8 0 0
    }
  }
}
MOTION"""
    text = (
        STANDING.replace("}\nMOTION", arms)
        .replace("  0 0 0\n", "  0 0 0  90 0 0\n")
        .replace("9 0 0\n", "9 0 0  90 0 0\n")
    )
    plain, raised = (prepare(written(tmp_path, lying(one)), height=1.7) for one in (STANDING, text))
    assert np.linalg.norm(raised.offsets[4]) == pytest.approx(np.linalg.norm(plain.offsets[4]), rel=1e-12)


def test_a_file_whose_rest_lies_stands_as_tall_as_told(shared_data):
    path = shared_data / "cases" / "04-bvh-lying-rest" / "rest_along_x.bvh"
    for t in (0.0, 0.05):
        assert np.ptp(prepare(path, height="1.72 m").pose(t)[1][:, 1]) == pytest.approx(1.72, rel=1e-12)
    assert "along y, 171 units" in BVH().describe_motion(path)["stands"]


def z_up(text):
    return text.replace("0 0.9 0  0 0 0", "0 0 0.9  0 90 0")


def test_a_body_along_z_is_asked_about_and_both_remedies_work(tmp_path):
    path = written(tmp_path, z_up(STANDING))
    with pytest.raises(BadInput, match="the body lies") as refused:
        prepare(path)
    assert refused.value.field == "up" and "up: z" in refused.value.remedy and "up: y" in refused.value.remedy
    assert np.ptp(prepare(path, up="z").pose(0.0)[1], axis=0)[1] == pytest.approx(1.7, rel=1e-12)
    assert np.ptp(prepare(path, up="y", scale=1).pose(0.0)[1], axis=0)[2] == pytest.approx(1.7, rel=1e-12)
    assert BVH().describe_motion(path)["stands"].startswith("along z, 1.7 units")


@pytest.mark.parametrize(("written_rate", "rate"), [("30", "30 Hz"), ("30", "0.033333333 Hz"), ("33.3333", "30 Hz")])
def test_a_frame_time_that_is_a_rate_is_asked_about(written_rate, rate, tmp_path):
    path = written(tmp_path, STANDING.replace("Time: 0.04", f"Time: {written_rate}"))
    with pytest.raises(BadInput, match="no time between two frames") as refused:
        prepare(path)
    assert "frame_rate: " in refused.value.remedy and "Hz" in refused.value.remedy
    mover = prepare(path, frame_rate=rate, up="y")
    dt = 1.0 / float(rate.split()[0])
    assert np.abs(mover.pose(0.99 * dt)[1] - mover.pose(dt)[1]).max() > 0.0
    np.testing.assert_array_equal(mover.pose(dt)[1], mover.pose(9.0 * dt)[1])


@pytest.mark.parametrize(("scale", "unit"), [("1 m", "1cm"), ("1 cm", ""), ("1 inch", "1cm"), ("1 mm", "1cm")])
def test_a_scale_that_makes_no_person_is_told_with_the_one_that_does(scale, unit, tmp_path):
    text = STANDING
    for value in ("0.1", "0.2", "0.4", "-0.5", "-0.4", "0.9"):
        text = text.replace(f" {value} ", f" {100 * float(value):g} ")
    (*said,) = prepare(written(tmp_path, text), scale=scale).notes
    assert len(said) == bool(unit) and all(f"scale: {unit}" in one for one in said)


@pytest.mark.parametrize("name", ["six_same", "some_six"])
def test_positions_of_inner_joints_are_used(name, shared_data):
    assert_shape_agrees(shared_data / "cases" / "12-bvh-six-channels" / f"{name}.bvh", 1.0 / 30.0, range(3))


SIX = """CHANNELS 6 Zposition Xposition Yposition Xrotation Yrotation Zrotation"""


def test_joints_that_move_against_their_parents(tiny, tmp_path):
    """Positions in any order; also counted from the offset, as some programs do, where 0 is the skeleton's own."""
    rows = [row.split() for row in TINY.splitlines()[-5:]]
    for name, base in (("instead.bvh", (0.0, 0.3, -1.0)), ("added.bvh", (0.0, 0.0, 0.0))):
        values = [[*row[:9], *(f"{a + 0.02 * k}" for a in base), *row[9:]] for k, row in enumerate(rows)]
        head = TINY.replace("CHANNELS 3 Xrotation Yrotation Zrotation", SIX).partition("0 4 0 ")[0]
        written(tmp_path, head + "\n".join(map(" ".join, values)) + "\n", name)
    instead = assert_shape_agrees(tmp_path / "instead.bvh", 0.25, range(5))
    added = prepare(tmp_path / "added.bvh", scale=1)
    lengths = [np.linalg.norm(instead.pose(t)[1][3] - instead.pose(t)[1][0]) for t in (0.0, 1.0)]
    assert lengths[1] - lengths[0] != pytest.approx(0.0, abs=1e-3)
    for t in (0.0, 0.1, 0.5, 1.0):
        np.testing.assert_allclose(added.pose(t)[1], instead.pose(t)[1], atol=1e-12)


def test_one_rotation_channel_and_positions_last(tmp_path):
    text = STANDING.replace("CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation",
                            "CHANNELS 6 Yrotation ZROTATION Xrotation Yposition Zposition Xposition")  # fmt: skip
    text = text.replace("OFFSET 0 -0.5 0\n      CHANNELS 3 Zrotation Xrotation Yrotation",
                        "OFFSET 0 -0.5 0\n      CHANNELS 1 Xrotation")  # fmt: skip
    head = text.partition("0 0.9 0")[0]
    path = written(
        tmp_path, head + "10 20 30 1 2 3  1 2 3  4 5 6  7 8 9  10\n30 20 10 2 3 1  3 2 1  6 5 4  9 8 7  40\n"
    )
    nodes, motion = parse(path.read_text().replace("ZROTATION", "Zrotation"))
    mover, shift = prepare(path, scale=1, up="y"), None
    for k in range(2):
        # The root's place is not turned, wherever its channels stand.
        nodes[0][3].sort(key=lambda channel: channel.endswith("rotation"))
        row = np.concatenate([motion[k][3:6], motion[k][:3], motion[k][6:]])
        expected, found = kinematics(nodes, row), mover.pose(k * 0.04)[1]
        shift = found[0] - expected[0] if shift is None else shift
        np.testing.assert_allclose(found, expected + shift, atol=1e-12)


def test_names_in_latin_1_and_a_byte_order_mark(tmp_path):
    text = STANDING.replace("JOINT Head", "JOINT Tête-Head")
    one, other = (prepare(written(tmp_path, text, f"{how}.bvh", how)) for how in ("latin-1", "utf-8-sig"))
    assert one.joints == other.joints and "Tête-Head" in one.joints
    np.testing.assert_array_equal(one.pose(0.01)[1], other.pose(0.01)[1])


ARM = """HIERARCHY
ROOT base
{
  OFFSET 0 0 0
  CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation
  JOINT shoulder
  {
    OFFSET 0 0.2 0
    CHANNELS 3 Zrotation Xrotation Yrotation
    JOINT elbow
    {
      OFFSET 0 0.3 0
      CHANNELS 3 Zrotation Xrotation Yrotation
      JOINT tool
      {
        OFFSET 0 0.25 0
        CHANNELS 3 Zrotation Xrotation Yrotation
        End Site
        {
          OFFSET 0 0.05 0
        }
      }
    }
  }
}
MOTION
Frames: 2
Frame Time: 0.04
0 0 0  0 0 0  0 0 0  0 0 0  0 0 0
0.4 0 0.1  10 20 30  40 50 0  60 0 0  0 0 70
"""
"""A robot's arm, 0.8 units from its base to its tip."""
LINKS = np.array([0.2, 0.3, 0.25, 0.05])
CHAIN = """HIERARCHY
ROOT shoulder
{
  OFFSET 0 0 0
  CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation
  JOINT elbow
  {
    OFFSET 0.3 0 0
    CHANNELS 3 Zrotation Xrotation Yrotation
    End Site
    {
      OFFSET 0.25 0 0
    }
  }
}
MOTION
Frames: 1
Frame Time: 0.02
0 0.5 0 0 0 0 0 0 0
"""
"""An arm that points along x: it has no height."""


def followed(path, **config):
    return Topic().prepare(TopicConfig(skeleton=str(path), **config), Anywhere())


def scales_of(remedy):
    """The lengths of a unit that a text proposes."""
    return re.findall(r"scale: ([\d.]+\w+)", remedy)


@pytest.mark.parametrize(("scale", "unit"), [(None, 1.0), ("1 m", 1.0), ("1 cm", 0.01), ("2 ft", 0.6096)])
def test_links_that_poses_move_are_as_long_as_the_file_times_its_scale(scale, unit, tmp_path):
    """Each capsule runs from joint to joint of forward kinematics in metres."""
    path = written(tmp_path, ARM)
    mover, radius = followed(path, scale=scale), 0.01 * unit
    np.testing.assert_allclose(np.linalg.norm(mover.offsets[1:], axis=1), unit * LINKS, rtol=1e-14)
    assert mover.notes == ()
    radii = {"base": radius, "shoulder": radius, "elbow": radius, "tool": radius}
    links = Skeleton().build(SkeletonConfig(split=False, radii=radii), mover, Anywhere())
    nodes, motion = parse(path.read_text())
    rotation, place = prepare(path, scale=unit).pose(0.04)
    expected = unit * kinematics(nodes, motion[1])
    expected += place[0] - expected[0]
    matrices = rotation_matrices(rotation)
    assert links.frame.tolist() == [0, 1, 2, 3]
    for link, j in enumerate(links.frame):
        start, end = (expected[j] + matrices[j] @ x[link] for x in (links.a, links.b))
        cap = radius if link == 3 else 0.0
        np.testing.assert_allclose(start, expected[link], atol=1e-12)
        np.testing.assert_allclose(np.linalg.norm(end - expected[link + 1]), cap, atol=1e-12)


def test_a_followed_skeleton_waits_as_the_scene_turns_it(tmp_path):
    path, half = written(tmp_path, ARM.replace("Time: 0.04", "Time: 30")), np.sqrt(0.5)
    plain = followed(path, position=(1, 2, 3))
    turned = followed(path, position=(1, 2, 3), rotation=(half, half, 0, 0))
    way = plain.pose(0.0)[1] - [1, 2, 3]
    assert np.ptp(way[:, 1]) == pytest.approx(0.8, rel=1e-14)
    np.testing.assert_allclose(turned.pose(0.0)[1] - [1, 2, 3], way[:, [0, 2, 1]] * [1, -1, 1], atol=1e-14)
    matrices = rotation_matrices(turned.pose(0.0)[0])
    for j in range(1, 5):
        parent = turned.parents[j]
        reached = turned.pose(0.0)[1][parent] + matrices[parent] @ turned.offsets[j]
        np.testing.assert_allclose(reached, turned.pose(0.0)[1][j], atol=1e-14)


@pytest.mark.parametrize("unit", ["1cm", "1mm"])
def test_a_followed_skeleton_that_is_hardly_in_metres_needs_its_scale(unit, tmp_path):
    times = {"1cm": 100, "1mm": 1000}[unit]
    text = ARM.replace("0.25", f"{0.25 * times:g}").replace("0.05", f"{0.05 * times:g}")
    path = written(tmp_path, text.replace(" 0.2 ", f" {0.2 * times:g} ").replace(" 0.3 ", f" {0.3 * times:g} "))
    with pytest.raises(BadInput, match="not be in metres") as refused:
        followed(path)
    assert refused.value.field == "scale"
    assert unit in refused.value.remedy
    for scale, length in ((unit, 0.8), (scales_of(refused.value.remedy)[-1], 0.8 * times)):
        assert np.ptp(followed(path, scale=scale).pose(0.0)[1][:, 1]) == pytest.approx(length, rel=1e-12)
    with pytest.raises(BadInput, match="no skeleton") as refused:
        Topic().prepare(TopicConfig(scale=unit), Anywhere())
    assert refused.value.field == "scale"


@pytest.mark.parametrize(("text", "length"), [(ARM, 0.8), (CHAIN, 0.55)])
def test_what_is_no_person_gets_no_persons_height(text, length, tmp_path):
    """Without a stated size it is refused, and each remedy works; an explicit scale needs no height."""
    path = written(tmp_path, text)
    with pytest.raises(BadInput, match="trunk and legs") as refused:
        prepare(path)
    assert refused.value.field == "scale"
    (scale,) = scales_of(refused.value.remedy)
    mover = prepare(path, scale=scale)
    assert np.linalg.norm(mover.offsets, axis=1).sum() == pytest.approx(length, rel=1e-12) and mover.notes == ()
    assert "height: 1.7 m" in refused.value.remedy
    if text == ARM:
        assert np.linalg.norm(prepare(path, height=1.7).offsets, axis=1).sum() == pytest.approx(1.7, rel=1e-12)
    else:
        with pytest.raises(BadInput, match="has no height") as refused:
            prepare(path, height=1.7)
        assert scales_of(refused.value.remedy) == [scale]
    facts = BVH().describe_motion(path)
    assert f"{length:g}" in facts["size"] and "stands" not in facts


@pytest.mark.parametrize("size", [0.003, 0.02, 0.2, 0.32, 0.6, 4.0, 300.0])
def test_a_warning_about_a_scale_names_one_that_makes_a_person(size, tmp_path):
    numbers = re.compile(r"(?<=OFFSET )(.+) (.+) (.+)|(?<=^0 )(0\.9)", re.MULTILINE)
    path = written(
        tmp_path, numbers.sub(lambda m: " ".join(f"{size / 1.7 * float(n):.9g}" for n in m[0].split()), STANDING)
    )
    (said,) = prepare(path, scale=1).notes
    assert f"{size:.3g} m high" in said
    (scale,) = scales_of(said)
    assert prepare(path, scale=scale).notes == ()
