"""Engines in which a skirt swings get one skirt, and one judge looks at what they publish."""

from __future__ import annotations

import importlib
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from nuno.cli import main
from nuno_bench.peers import command as peers
from nuno_bench.peers import skirt as problem
from nuno_bench.peers.process import Engine, EnginePoint
from nuno_bench.peers.skirt import Skirt, SkirtComparison, SkirtSolver, hula_skirt, look
from nuno_bench.peers.skirt_newton import _from_z, lay_flat
from nuno_schemas.bodies import rotation_matrices
from nuno_schemas.errors import RunFailed
from nuno_schemas.fabric import Float

HERE = str(Path(__file__).parent)
SMALL = tuple(f"objects.0.model.{each}" for each in ("columns=24", "rows=8", "pleats=2"))


@pytest.fixture(scope="module")
def skirt() -> Skirt:
    """Coarse, at the beginning of its scene, where it hangs as it was made."""
    return hula_skirt(0.05, 0.0, SMALL)


def still(skirt: Skirt) -> Float:
    """(frames, n, 3) [m] where nothing moves."""
    return np.tile(skirt.x, (skirt.frames, 1, 1))


@pytest.mark.full
def test_frames_are_judged_by_how_far_off_and_how_stretched_they_are(skirt: Skirt) -> None:
    """A shift by 5 mm is 5 mm over the box's diagonal; scaled by 1.01 every spring is as many times as long."""
    exact = still(skirt)
    seen = look(skirt, exact + np.array([0.0, 3e-3, 4e-3]), exact)
    size = np.linalg.norm(skirt.x.max(axis=0) - skirt.x.min(axis=0))
    assert seen.off == pytest.approx((5e-3 / size,) * 3)
    own, wide = look(skirt, exact, exact), look(skirt, 1.01 * exact, exact)
    assert (seen.hem, seen.radius) == pytest.approx((own.hem + 3e-3, own.radius))
    assert (1.01 * own.hem, 1.01 * own.radius) == pytest.approx((wide.hem, wide.radius))
    assert 1.0 + wide.stretch == pytest.approx(1.01 * (1.0 + own.stretch))
    assert seen.crossed == ()


@pytest.mark.full
def test_frames_are_judged_by_what_passes_through_cloth_and_body(skirt: Skirt, monkeypatch: pytest.MonkeyPatch) -> None:
    """In the second frame a vertex of the hem is on the axis of a shin, whose radius is its depth.

    In the third it is beyond the other side of the skirt, so that its edges go through cloth.
    """
    frames, last = still(skirt), len(skirt.x) - 1
    shape, poses = skirt.geometry, skirt.poses[2]
    capsule = next(i for i, frame in enumerate(shape.frame) if shape.frames[frame].endswith("left_shin"))
    turned = rotation_matrices(poses.rotation[shape.frame[capsule], None])[0]
    middle = 0.5 * (shape.a[capsule] + shape.b[capsule])
    frames[1, last] = turned @ middle + poses.translation[shape.frame[capsule]]
    frames[2, last] = skirt.x[last] * [-2.0, 1.0, -2.0]
    monkeypatch.setattr(problem, "DIVERGED", np.inf)  # its edges are long
    seen = look(skirt, frames, still(skirt))
    assert seen.depth == pytest.approx(shape.radius[capsule])
    assert seen.vertices[1] == seen.vertices[0] + 1
    assert seen.edges[1] > seen.edges[0]
    assert seen.crossed == (3,)
    if seen.ipctk is not None:
        assert seen.ipctk == 1


@pytest.mark.full
def test_cloth_that_is_torn_apart_has_diverged(skirt: Skirt) -> None:
    frames = still(skirt)
    frames[1:, -1, 1] -= 100.0
    with pytest.raises(RunFailed, match=r"diverged.* in frame 2"):
        look(skirt, frames, still(skirt))


@pytest.mark.full
def test_triangles_lie_flat_as_long_as_their_springs(skirt: Skirt) -> None:
    rest = dict(zip(map(frozenset, skirt.pairs.tolist()), skirt.rest.tolist(), strict=True))
    for face, flat in zip(skirt.faces.tolist(), lay_flat(skirt), strict=True):
        for i in range(3):
            length = np.linalg.norm(flat[i] - flat[i - 1])
            assert length == pytest.approx(rest[frozenset((face[i], face[i - 1]))], rel=1e-12)


@pytest.mark.parametrize("direction", [(0.0, 0.0, 1.0), (0.0, 0.0, -1.0), (0.6, 0.0, 0.8), (-2 / 3, 2 / 3, -1 / 3)])
def test_capsules_along_z_are_turned_to_their_axis(direction: tuple[float, float, float]) -> None:
    x, y, z, w = _from_z(np.array(direction))
    turned = rotation_matrices(np.array([[w, x, y, z]]))[0]
    np.testing.assert_allclose(turned @ [0.0, 0.0, 1.0], direction, rtol=0, atol=1e-15)


@pytest.mark.full
def test_our_solver_goes_on_as_if_it_had_not_been_stopped() -> None:
    """Where the scene's own run is after two more frames; and what holds the waist moves with the hips.

    What a solver remembers beside places and velocities, as contact does, is not handed on, which is worth 9 um here, a
    hundredth of the thickness. Without the velocities cloth would be some 10 mm off.
    """
    start, later = hula_skirt(2 / 60, 4 / 60), hula_skirt(1 / 60, 6 / 60)
    frames = SkirtSolver(start, "plugin: respa, dt: auto").advance(2 / 60)
    np.testing.assert_allclose(frames[-1], later.x, rtol=0, atol=0.02 * start.thickness)
    for i, x in enumerate(frames):
        np.testing.assert_allclose(start.waist(*start.places(i, 1.0)), x[start.pinned], rtol=0, atol=1e-12)


@pytest.mark.full
@pytest.mark.parametrize(("made", "substeps", "iterations"), [("XPBD", 100, 1), ("VBD", 10, 4), ("Style3D", 10, 4)])
def test_newton_has_the_masses_the_hinges_and_the_waist_of_the_skirt(
    skirt: Skirt, made: str, substeps: int, iterations: int
) -> None:
    pytest.importorskip("newton", reason="the peer engine newton is not installed")
    engine = getattr(importlib.import_module("nuno_bench.peers.skirt_newton"), made)(skirt, substeps, iterations)
    np.testing.assert_allclose(engine.model.particle_mass.numpy(), skirt.mass * skirt.free, rtol=1e-6)
    quads, k = engine.model.edge_indices.numpy(), engine.model.edge_bending_properties.numpy()[:, 0]
    if made != "Style3D":  # which has a fabric of its own
        length = np.linalg.norm(skirt.flat[quads[:, 2]] - skirt.flat[quads[:, 3]], axis=1) if made == "VBD" else 1.0
        np.testing.assert_allclose((k * length)[: len(skirt.bend)], skirt.bend, rtol=1e-5)
        assert not k[len(skirt.bend) :].any()
        assert (quads[: len(skirt.bend)] == skirt.quads[:, [2, 3, 0, 1]]).all()
    frames = engine.advance(0.05)
    assert np.isfinite(frames).all() and len(frames) == 3
    for i, x in enumerate(frames):
        np.testing.assert_allclose(x[skirt.pinned], skirt.waist(*skirt.places(i, 1.0)), rtol=0, atol=1e-6)


@pytest.mark.full
def test_another_engine_is_held_against_our_fastest_that_is_no_farther_off(skirt: Skirt) -> None:
    near, far = (look(skirt, still(skirt) + off, still(skirt)) for off in (0.0, 0.01))
    points = [
        EnginePoint("converged", "fine", None, (9.0,), near),
        EnginePoint("nuno-a", "loose", 1.0, (1.0,), far),
        EnginePoint("nuno-a", "tight", 1.0, (4.0,), near),
        EnginePoint("newton-b", "near", 1.0, (2.0,), near),
        EnginePoint("newton-b", "far", 1.0, (2.0,), far),
        EnginePoint("newton-b", "breaks", failure="not done after 9 s"),
    ]
    found = SkirtComparison([Engine(name, "", "", "", {}, "") for name in ("nuno-a", "newton-b")], points, (), skirt)
    rows = [row[-2:] for row in found.settings().rows]
    assert rows == [["", ""], ["", ""], ["", ""], ["0.5", "missed"], ["2", "bar met"], ["", "failed"]]
    assert [point.setting for point in found.nearest()] == ["fine", "tight", "near"]


@pytest.mark.full
def test_page_shows_ends_side_by_side_and_says_what_fails(
    skirt: Skirt, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    kinds = (
        Engine("fake-skirt", "", "fake_engines", "Drifts", {"drifts": {"by": 0.01}}, "A skirt."),
        Engine("fake-refuse", "", "fake_engines", "Refuse", {"breaks": {"shift": 0.0}}, "A skirt."),
        Engine("fake-none", "no_such_engine", "fake_engines", "Drifts", {"drifts": {"by": 0.01}}, "A skirt."),
    )
    docs, html = tmp_path / "page.md", tmp_path / "page.html"
    docs.write_text("before\n<!-- measured: peers skirt -->\n<!-- end: peers skirt -->\nafter\n")
    exact = still(skirt)
    monkeypatch.setenv("PYTHONPATH", HERE)
    monkeypatch.setitem(peers.SCENES, "skirt", replace(peers.SCENES["skirt"], kinds=kinds))
    monkeypatch.setattr(peers, "hula_skirt", lambda seconds, threads: skirt)
    point = EnginePoint("converged", "fine", None, (1.0,), look(skirt, exact, exact))
    monkeypatch.setattr(peers, "converge", lambda skirt, seconds: (exact, [point]))
    argv = ["bench", "peers", "skirt", "--repeats", "1", "--out", str(tmp_path), "--html", str(html)]
    assert main([*argv, "--docs", str(docs)]) == 0
    data, told = json.loads((tmp_path / "peers-skirt.json").read_text()), docs.read_text()
    assert data["points"][1]["score"]["off"] == pytest.approx([0.01 / skirt.size] * 3)
    assert "RuntimeError: unstable at step 7" in told and "fake-none: no_such_engine is not installed" in told
    assert html.read_text().count("data:image/png") == 2


@pytest.mark.parametrize("argv", [["contact", "--duration", "0.5"], ["skirt", "--duration", "0.001"]])
def test_durations_that_cannot_be_are_refused(argv: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bench", "peers", *argv]) == 2
    assert "--duration" in capsys.readouterr().err
