"""A body that deforms as it was animated: one character in every format, glTF's interpolation, and what is refused."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import animated_tube as hero
import numpy as np
import pytest
from skin_files import Folder

from nuno_contact.motions import vertex_cache
from nuno_contact.motions.animation import Animation, AnimationConfig, SurfaceCollider, SurfaceConfig
from nuno_geometry.check import closed_parts, volume
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Float
from nuno_schemas.plugin import BodyShape, Mover

FRAMES = 13
X, FACES = hero.tube()
TIMES = hero.times(FRAMES)
TRUE = np.stack([hero.posed(X, t) for t in TIMES])
SINGLE = 5e-7
"""what seven digits of a file leave of these positions [m]"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Folder:
    root = tmp_path_factory.mktemp("hero")
    hero.write_glb(root / "hero.glb", X, FACES, TIMES)
    hero.write_usd(root / "hero.usdc", X, FACES, FRAMES)
    hero.write_sequence(root, TRUE, FACES)
    (root / "rest.obj").write_bytes((root / "tube_95.obj").read_bytes())
    hero.write_npz(root / "hero.npz", TRUE, FACES, times=TIMES)
    hero.write_pc2(root / "hero.pc2", TRUE)
    hero.write_mdd(root / "hero.mdd", TRUE)
    return Folder(root)


FORMATS: dict[str, dict[str, Any]] = {
    "hero.glb": {"clip": "Walk"}, "hero.usdc": {}, "tube_95.obj": {"frame_rate": 24.0}, "hero.npz": {},
    "hero.pc2": {"frame_rate": 24.0, "faces": "rest.obj"}, "hero.mdd": {"faces": "rest.obj"},
}  # fmt: skip


def move(folder: Folder, file: str, **settings: Any) -> Mover:
    return Animation().prepare(AnimationConfig(file=file, **settings), folder)


def shape_of(mover: Mover, folder: Folder) -> BodyShape:
    return SurfaceCollider().build(SurfaceConfig(), mover, folder)


@pytest.mark.parametrize("file", FORMATS)
def test_every_format_gives_the_formula_s_vertices(folder: Folder, file: str) -> None:
    """At frames to the files' seven digits, between them in straight lines; then the last pose is held."""
    mover = move(folder, file, **FORMATS[file])
    assert mover.surface is not None and np.array_equal(mover.surface, FACES) and volume(X, FACES) > 0.0
    for k, t in enumerate(TIMES.tolist()):
        rotation, x = mover.pose(t)
        assert np.abs(x - TRUE[k]).max() < SINGLE
        assert (rotation == np.array([1.0, 0.0, 0.0, 0.0])).all()
    between = 0.3 * TRUE[4] + 0.7 * TRUE[5]
    assert np.abs(mover.pose(4.7 / hero.RATE)[1] - between).max() < SINGLE
    assert np.array_equal(mover.pose(100.0)[1], mover.pose(TIMES[-1])[1])


def test_a_surface_is_where_its_motion_has_it(folder: Folder) -> None:
    """A skin with a joint for each vertex bends to the motion's positions, to the last digits; and it is closed."""
    mover = move(folder, "hero.npz")
    shape = shape_of(mover, folder)
    still = np.tile([1.0, 0.0, 0.0, 0.0], (len(X), 1))
    for t in (0.0, 0.1234, 0.5, 2.0):
        x = mover.pose(t)[1]
        assert np.abs(shape.skins[0].bend(shape.vertices, still, x) - x).max() < 1e-15
    assert shape.notes == () and shape.skins[0].is_surface


def test_start_and_preroll_shift_the_motion_and_scale_and_up_its_axes(folder: Folder) -> None:
    mover = move(folder, "hero.npz", start=2 / hero.RATE, preroll=0.5, scale=0.5, up="z")
    want = 0.5 * TRUE[:, :, [0, 2, 1]] * np.array([1.0, 1.0, -1.0])
    for t, k in ((0.0, 2), (0.5, 2), (0.5 + 3 / hero.RATE, 5), (9.0, FRAMES - 1)):
        assert np.abs(mover.pose(t)[1] - want[k]).max() < SINGLE
    assert mover.lasts == pytest.approx(0.5 + (FRAMES - 3) / hero.RATE)


@pytest.mark.parametrize(("how", "at"), [("STEP", 0.0), ("LINEAR", 0.25), ("CUBICSPLINE", 0.25 + 0.125 * (0.8 - 0.2))])
def test_keys_are_interpolated_as_gltf_says(tmp_path: Path, how: str, at: float) -> None:
    """A node goes from 0 to 0.5 m in a second: halfway it has not moved yet, is in the middle, or where the spline's
    tangents, 0.8 out and 0.2 in, have it (glTF 2.0, C.5). More samples than keys show it: 24 a second.
    """
    glb = hero.Glb()
    zero, one = np.zeros(3), np.array([1.0, 0.0, 0.0])
    values = np.array([zero, 0.5 * one])
    if how == "CUBICSPLINE":
        values = np.array([zero, zero, 0.8 * one, 0.2 * one, 0.5 * one, zero])
    sampler = {"input": glb.add([0.0, 1.0], "SCALAR"), "output": glb.add(values, "VEC3"), "interpolation": how}
    clip = {"samplers": [sampler], "channels": [{"sampler": 0, "target": {"node": 0, "path": "translation"}}]}
    part = {"attributes": {"POSITION": glb.add(X, "VEC3")}, "indices": glb.add(FACES, "SCALAR", 5125)}
    glb.write(tmp_path / "node.glb", {"nodes": [{"mesh": 0}], "meshes": [{"primitives": [part]}], "animations": [clip]})
    mover = move(Folder(tmp_path), "node.glb")
    assert np.abs(mover.pose(0.5)[1] - X - np.array([at, 0.0, 0.0])).max() < SINGLE
    assert np.abs(mover.pose(1.0)[1] - X - 0.5 * one).max() < SINGLE


def test_clips_play_together_and_one_left_out_is_named(tmp_path: Path) -> None:
    """Blender exports the shape keys' motion as a clip of its own: without it they would stand still, unsaid."""
    hero.write_glb(tmp_path / "hero.glb", X, FACES, TIMES, split=True)
    both = move(Folder(tmp_path), "hero.glb", clip=["Walk", "Keys"])
    assert np.abs(both.pose(TIMES[6])[1] - TRUE[6]).max() < SINGLE and both.notes == ()
    alone = move(Folder(tmp_path), "hero.glb", clip="Walk")
    assert np.abs(alone.pose(TIMES[6])[1] - TRUE[6]).max() > 5e-3
    assert alone.notes == ("its shape keys move in another clip: clip: [Walk, Keys] plays both",)


def test_seams_are_joined_where_their_sides_go_together(tmp_path: Path) -> None:
    """Triangles with corners of their own, as files have them for normals, are one closed surface; two tubes that touch
    in one frame alone stay two.
    """
    loose = FACES.ravel()
    hero.write_npz(tmp_path / "loose.npz", TRUE[:, loose], np.arange(len(loose)).reshape(-1, 3), times=TIMES)
    mover = move(Folder(tmp_path), "loose.npz")
    assert mover.surface is not None and len(mover.joints) == len(X) and closed_parts(mover.surface).all()
    both = np.concatenate([FACES, FACES + len(X)])
    apart = np.concatenate([TRUE, TRUE + 0.01 * TIMES[:, None, None]], axis=1)
    hero.write_npz(tmp_path / "apart.npz", apart, both, times=TIMES)
    assert len(move(Folder(tmp_path), "apart.npz").joints) == 2 * len(X)


def test_an_open_surface_is_noted_and_its_closed_parts_have_an_inside(tmp_path: Path) -> None:
    x, faces = hero.tube(closed=False)
    both = np.concatenate([x, X + 1.0])
    triangles = np.concatenate([faces, FACES + len(x)])
    frames = np.stack([both, both + 0.1])
    hero.write_npz(tmp_path / "open.npz", frames, triangles, times=[0.0, 0.1])
    shape = shape_of(move(Folder(tmp_path), "open.npz"), Folder(tmp_path))
    assert shape.notes[-1].startswith(f"{len(faces)} of {len(triangles)} triangles are of parts with a rim")
    assert np.array_equal(closed_parts(shape.faces), np.arange(len(triangles)) >= len(faces))


def spoiled(frame: int, vertex: int, by: float) -> Float:
    frames = TRUE.copy()
    frames[frame, vertex] += by
    return frames


REFUSED: dict[str, tuple[str, dict[str, Any], tuple[str, ...]]] = {
    "unknown clip": ("hero.glb", {"clip": "walk"}, ("no such clip", "did you mean 'Walk'?", "Rest")),
    "several clips": ("hero.glb", {}, ("several clips", "Walk, Rest", "clip: [Walk, Rest]")),
    "still clip": ("hero.glb", {"clip": "Rest"}, ("the clip moves nothing",)),
    "unknown mesh": ("hero.glb", {"clip": "Walk", "mesh": "body"}, ("mesh", "did you mean 'Body'?")),
    "unknown prim": ("hero.usdc", {"mesh": "Bdy"}, ("mesh", "did you mean 'Body'?")),
    "no rate": ("tube_95.obj", {}, ("frame_rate", "frame_rate: 24 Hz")),
    "no faces": ("hero.mdd", {}, ("faces", "positions alone")),
    "other faces": ("hero.mdd", {"faces": "other.obj"}, ("faces", "of another mesh", "158 vertices")),
    "no sequence": ("still.obj", {"frame_rate": 24.0}, ("one mesh is no motion", "hero_0001.obj")),
    "missing frame": ("gap_1.obj", {"frame_rate": 24.0}, ("a frame is missing", "frame 3")),
    "other topology": ("topo_1.obj", {"frame_rate": 24.0}, ("topo_2.obj", "another topology", "206 vertices")),
    "nan": ("nan.npz", {}, ("not a finite position", "sample 4, vertex 17")),
    "jump": ("jump.npz", {}, ("the body jumps", "sample 6, vertex 3", "m/s at 0.25 s", "scale")),
    "too late": ("hero.npz", {"start": 0.6}, ("start", "lasts 0.5 s")),
    "still": ("still.npz", {}, ("nothing of it moves",)),
    "field of another kind": ("hero.npz", {"clip": "Walk"}, ("clip", "takes no clip", "leave it out")),
    "alembic": ("hero.abc", {}, ("Alembic", "usd_export")),
    "cut off": ("cut.pc2", {"frame_rate": 24.0, "faces": "rest.obj"}, ("cannot be read as PC2", "13 samples of 158")),
    "of several files": ("layered.usda", {}, ("names other files", "usdcat --flatten")),
}


@pytest.mark.parametrize("case", REFUSED)
def test_bad_input_is_named_with_its_remedy(folder: Folder, case: str) -> None:
    file, settings, words = REFUSED[case]
    root = folder.root
    small, few = hero.tube(17)
    hero.write_npz(root / "nan.npz", spoiled(4, 17, np.nan), FACES, times=TIMES)
    hero.write_npz(root / "jump.npz", spoiled(6, 3, 3.0), FACES, times=TIMES)
    hero.write_npz(root / "still.npz", TRUE[[0, 0]], FACES, times=TIMES[:2])
    (root / "still.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    for name, number in (("gap", 1), ("gap", 2), ("gap", 4), ("topo", 1)):
        (root / f"{name}_{number}.obj").write_bytes((root / "rest.obj").read_bytes())
    hero.write_sequence(root, small[None], few, 2)
    (root / "tube_2.obj").rename(root / "topo_2.obj")
    (root / "other.obj").write_bytes((root / "topo_2.obj").read_bytes())
    (root / "hero.abc").write_bytes(b"Ogawa")
    (root / "cut.pc2").write_bytes((root / "hero.pc2").read_bytes()[:-7])
    (root / "layered.usda").write_text("#usda 1.0\n(\n    subLayers = [@./hero.usdc@]\n)\n")
    with pytest.raises(BadInput) as error:
        move(folder, file, **settings)
    text = str(error.value)
    assert all(word in text for word in (*words, str(root))), text


def test_more_memory_than_there_is_to_be_is_refused_before_it_is_taken(
    folder: Folder, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(vertex_cache, "MOST", TRUE.size * 4 - 1)
    with pytest.raises(BadInput, match="too large") as error:
        move(folder, "hero.npz")
    assert "13 samples of 158 vertices" in str(error.value)
