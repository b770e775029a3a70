"""`nuno export --yarns`: a knit's yarns as curves, read back as they were made, and off the body where it then is."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from recorded_sheet import Sheet, write

import nuno
from nuno.cli import main
from nuno.exports.cloth import read_frame
from nuno.exports.yarns import Form, export_yarns, make_yarns
from nuno.python_api.export import tell_yarns
from nuno.recording.reader import open_recording
from nuno_contact.body_shapes.leg import leg_mesh
from nuno_geometry.closest_point import closest_points
from nuno_geometry.tree import build_tree
from nuno_schemas.fabric import Float

MOVED = 0.02
"""The leg goes up by this much [m] in the run."""
LEG = {"plugin": "mesh", "shape": "leg", "resolution": 24, "centre": [0, -0.55, 0]}
UP = {"plugin": "keyframes", "times": [0, 0.1], "positions": [[0, 0, 0], [0, MOVED, 0]]}


def scene(**fields: Any) -> dict[str, Any]:
    """A tube of four columns about a thigh: its points are outside, and its links cut through."""
    knit = {
        "plugin": "knit", "form": "tube", "wales": 2, "courses": 6, "spacing": [0.14, 0.02], "mass": 1,
        "yarns": [{"name": "soft", "k": 1}, {"name": "stiff", "k": 10}],
    }  # fmt: skip
    plain: dict[str, Any] = {
        "nuno": 1,
        "name": "thigh",
        "duration": 0.1,
        "frame_rate": 20,
        "solver": {"plugin": "symplectic_euler", "dt": 0.01},
        "gravity": [0, 0, 0],
        "bodies": [{"name": "leg", "collider": LEG, "motion": UP}],
        "contact": {"plugin": "sliding"},
        "objects": [{"name": "knit", "model": knit}],
    }
    return plain | fields


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("yarns")
    (folder / "scene.yaml").write_text(yaml.safe_dump(scene()))
    nuno.run(folder / "scene.yaml", record=folder / "run.mcap")
    return folder / "run.mcap"


def below(points: Float, ptr: Any) -> float:
    """How deep the deepest of 20 samples a piece lies in the leg where it is at the end [m]."""
    x, faces = leg_mesh(24)
    tree = build_tree(x + np.array([0.0, -0.55 + MOVED, 0.0]), faces)
    first = np.delete(np.arange(len(points)), np.asarray(ptr)[1:] - 1)
    share = np.linspace(0.0, 1.0, 20)[:, None]
    placed = points[first][:, None] + share * (points[first + 1] - points[first])[:, None]
    return float(-closest_points(tree, placed.reshape(-1, 3)).distance.min())


@pytest.mark.parametrize("form", ["straight", "smooth"])
def test_arrays_are_read_back_as_they_were_made(form: Form, recorded: Path, tmp_path: Path) -> None:
    made = export_yarns(recorded, tmp_path / "yarns.npz", form=form, settings={"radius": 1e-4})
    assert made.curves is not None
    with np.load(tmp_path / "yarns.npz", allow_pickle=False) as file:
        for name in ("points", "ptr", "radius", "kind", "normal"):
            assert np.array_equal(file[name], getattr(made.curves, name)), name
        assert tuple(file["names"]) == made.curves.names == ("soft", "stiff")
        assert np.array_equal(file["face"], made.arrays["face"])
        assert file["t"] == pytest.approx(0.1) and file["frame"] == 2
    with open_recording(recorded) as recording:
        again = make_yarns(recording, read_frame(recording), form, {"radius": 1e-4})
    assert again.curves is not None and again.curves.points.tobytes() == made.curves.points.tobytes()


def test_links_that_cut_through_the_leg_are_repaired(recorded: Path, tmp_path: Path) -> None:
    made = export_yarns(recorded, tmp_path / "yarns.npz", form="straight")
    with open_recording(recorded) as recording:
        x = read_frame(recording).x
    assert made.curves is not None and made.facts["repaired"] > 10
    own = made.arrays["vertex"] >= 0
    assert np.array_equal(made.curves.points[own], x[made.arrays["vertex"][own]])
    assert below(x[made.arrays["vertex"][own]], _without(made.curves.ptr, own)) > 1e-3
    assert below(made.curves.points, made.curves.ptr) < 1e-5


def _without(ptr: Any, own: Any) -> Any:
    """The first points of yarns that keep `own` points."""
    return np.concatenate([[0], np.cumsum(own)])[ptr]


def test_smooth_yarns_are_a_radius_off_the_leg(recorded: Path, tmp_path: Path) -> None:
    made = export_yarns(recorded, tmp_path / "yarns.npz", form="smooth", settings={"radius": "0.5 mm"})
    assert made.curves is not None and (made.curves.radius == 5e-4).all()
    assert below(made.curves.points, made.curves.ptr) < -5e-4 + 1e-5


def test_polylines_are_read_back_by_kind(recorded: Path, tmp_path: Path) -> None:
    made = export_yarns(recorded, tmp_path / "yarns.obj", form="straight")
    assert made.curves is not None
    lines = (tmp_path / "yarns.obj").read_text().splitlines()
    assert lines[0].startswith("# nuno yarns of frame 2")
    assert [line[2:] for line in lines if line.startswith("o ")] == ["soft", "stiff"]
    points = np.array([line.split()[1:] for line in lines if line.startswith("v ")], np.float64)
    yarns = [np.array(line.split()[1:], np.int64) - 1 for line in lines if line.startswith("l ")]
    assert np.array_equal(np.concatenate(yarns), np.arange(len(made.curves.points)))
    order = np.argsort(made.curves.kind, kind="stable")
    for yarn, found in zip(order, yarns, strict=True):
        expected = made.curves.points[made.curves.ptr[yarn] : made.curves.ptr[yarn + 1]]
        assert np.array_equal(points[found], expected)


def test_the_command_writes_and_says_what_it_did(
    recorded: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "yarns.npz"
    assert main(["export", str(recorded), "--yarns", str(path), "--form", "straight", "--frame", "1"]) == 0
    out, err = capsys.readouterr()
    assert out.splitlines() == [str(path)]
    assert err.startswith("straight yarns: 52 links, ") and "cut through the body and were repaired" in err
    with np.load(path) as file:
        assert file["frame"] == 1


def test_without_a_mesh_smooth_yarns_follow_the_knit_alone(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    nuno.run("knit/stitch-10x10", "duration=0.3", record=tmp_path / "run.mcap")
    assert main(["export", str(tmp_path / "run.mcap"), "--yarns", str(tmp_path / "yarns.npz")]) == 0
    assert "no body is a mesh" in capsys.readouterr().err
    with np.load(tmp_path / "yarns.npz") as file:
        assert not file["normal"].any() and np.isfinite(file["points"]).all()


REFUSED = [
    (["--yarns", "y.ply"], ["--yarns", ".npz or .obj"]),
    (["--yarns", "y.npz", "--radius", "thin"], ["--radius", "quantity"]),
    (["--yarns", "y.npz", "--radius=-1mm"], ["--radius", "greater than or equal to 0"]),
    (["--yarns", "y.npz", "--curl", "0.5"], ["--curl", "0.3"]),
    (["--yarns", "y.npz", "--samples", "3"], ["--samples", "4"]),
    (["--yarns", "y.npz", "--form", "straight", "--samples", "8"], ["--samples", "no such setting"]),
    (["--yarns", "y.npz", "--frame", "9"], ["--frame", "frames 0 to 2"]),
    (["--samples", "8"], ["--samples", "add --yarns"]),
    (["--npz", "x.npz", "--form", "smooth"], ["--form", "add --yarns"]),
]


@pytest.mark.parametrize(("flags", "words"), REFUSED)
def test_what_cannot_be_made_is_refused_before_anything_is_written(
    flags: list[str], words: list[str], recorded: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    assert main(["export", str(recorded), *flags]) == 2
    err = capsys.readouterr().err
    assert all(word in err for word in words), err
    assert not list(tmp_path.iterdir())


def test_a_recording_without_yarns_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write(tmp_path / "run.mcap", Sheet(), 2)
    flags = ["--npz", str(tmp_path / "x.npz"), "--yarns", str(tmp_path / "yarns.npz")]
    assert main(["export", str(tmp_path / "run.mcap"), *flags]) == 2
    assert "has no yarns" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["run.mcap"]


def test_links_that_could_not_be_repaired_are_told() -> None:
    facts = {"links": 1e4, "points": 12345.0, "repaired": 7.0, "inserted": 9.0, "lost": 2.0, "samples": 5e5}
    text = tell_yarns("straight", facts | {"deepest": 1.234e-4})
    assert "10,000 links" in text and "2 could not be" in text and "123 um" in text


def test_exporting_other_things_loads_no_knit(recorded: Path, tmp_path: Path) -> None:
    """`nuno export --csv` does not pay for yarns."""
    code = (
        "import sys; from nuno.cli import main; "
        f"main(['export', {str(recorded)!r}, '--csv', {str(tmp_path / 'x.csv')!r}]); "
        "print({'nuno_knit.smooth', 'nuno_knit.repair', 'nuno.exports.yarns'} & set(sys.modules))"
    )
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert out.splitlines()[-1] == "set()"
