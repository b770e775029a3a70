"""Stability maps and the comparison of integrators: classes and verdicts follow from the figures."""

from __future__ import annotations

import csv
import itertools
import json
import math
import re
from dataclasses import replace
from html import unescape
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from nuno.cli import main
from nuno.plugin_contract import registry
from nuno.scene import scene_file, shipped
from nuno_bench import stability
from nuno_bench.integrators import SERIES, SPLIT, WHOLE, Cell, Setting, Trace, regions, report, run_variant
from nuno_bench.problem import Series
from nuno_bench.stability import (
    MapPoint,
    Variant,
    classify,
    make_reference,
    measure_all,
    measure_row,
    mesh_overrides,
    pose,
    settings_of,
    step_counts,
    stiffen,
)
from nuno_bench.sweep.executor import Executor, SweepFile, pack
from nuno_schemas.errors import BadInput, RunFailed

SCENE = """\
nuno: 1
name: small
duration: 0.1 s
frame_rate: 50 Hz
solver: {plugin: rk4, dt: auto}
objects:
  - name: cloth
    model: {plugin: sheet, resolution: [5, 4], pin: [top-corners], fabric: {structural: 20, shear: 5, density: 0.3}}
"""


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    path = tmp_path / "small.yaml"
    path.write_text(SCENE)
    return path


def made(offset: float = 0.0, energy: float = 0.0) -> Series:
    """A fall of 1 m with 1 J, or one that is `offset` [m] beside it at its end and has `energy` [J] more."""
    x = np.zeros((3, 1, 3))
    x[:, 0, 1] = [0.0, -0.25, -1.0]
    x[2, 0, 0] = offset
    parts = np.array([[0.0, 0.0], [-0.5, 0.5], [-1.0, 1.0 + energy]])
    return Series(np.arange(3.0), x, {}, parts)


@pytest.mark.parametrize(
    ("offset", "energy", "outcome"),
    [
        (0.0009, 0.0, "exact"),
        (0.0009, 0.9, "exact"),
        (0.0009, 1.1, "drifting"),
        (0.0009, -1.1, "damped away"),
        (0.0011, 0.9, "accurate"),
        (0.051, -0.06, "damped away"),
        (0.051, -0.04, "drifting"),
        (0.6, 0.0, "drifting"),
        (0.01, 99.0, "drifting"),
        (0.01, 101.0, "diverged"),
        (101.0, 0.0, "diverged"),
        (math.nan, 0.0, "diverged"),
    ],
)
def test_class_follows_from_distance_and_energy(offset: float, energy: float, outcome: str) -> None:
    assert classify(made(offset, energy), made())[0] == outcome


def row_of(scene: Path, solver: str, value: float = 1.0) -> list[MapPoint]:
    setting = Variant(pack(scene), (), "stiffness", value)
    posed = pose(setting)
    reference = make_reference(posed)
    limit = posed.limit(registry.load("nuno.integrators", solver), None).dt
    around = sorted({max(1, math.ceil(posed.frame / (limit * share))) for share in (0.25, 0.9, 1.5, 2.0)})
    return measure_row(posed, setting, solver, around, reference, 1e9, math.inf)


@pytest.mark.parametrize("solver", ["leapfrog", "rk4", "symplectic_euler"])
@pytest.mark.parametrize("value", [300.0, 10_000.0])
def test_maps_break_at_the_stated_limit(scene: Path, solver: str, value: float) -> None:
    points = row_of(scene, solver, value)
    limit = points[0].limit
    assert len(points) >= 3
    for point in points:
        if point.dt > 1.3 * limit:
            assert point.outcome == "diverged", point
        elif point.dt <= limit:
            assert point.outcome != "diverged", point
    assert points[-1].outcome in ("exact", "accurate")


def test_limits_shrink_with_the_root_of_the_stiffness(scene: Path) -> None:
    soft, stiff = (row_of(scene, "leapfrog", value)[0].limit for value in (100.0, 10_000.0))
    assert soft / stiff == pytest.approx(10.0, rel=0.05)


def test_stiffer_cloth_keeps_its_share_of_critical_damping(scene: Path) -> None:
    fabric = pose(Variant(pack(scene), (), "mesh", 1.0)).system.fabric
    assert fabric.springs is not None
    stiff = stiffen(fabric, 9.0).springs
    assert stiff is not None
    np.testing.assert_allclose(stiff.k, 9.0 * fabric.springs.k)
    np.testing.assert_allclose(stiff.c, 3.0 * fabric.springs.c)


def test_implicit_points_are_never_diverged(scene: Path) -> None:
    setting = Variant(pack(scene), (), "stiffness", 1e4)
    posed = pose(setting)
    reference = make_reference(posed)
    points = measure_row(posed, setting, "implicit_euler", [1, 8], reference, 1e9, math.inf)
    assert all(math.isinf(point.limit) for point in points)
    assert {point.outcome for point in points} <= {"damped away", "accurate", "drifting"}


def test_steps_reach_below_the_limit_of_a_hundred_times_the_stiffness() -> None:
    counts = step_counts(0.02, 1000.0)
    assert counts[0] == 1
    assert 0.02 / counts[-1] <= 2.0 / 10_000.0
    assert [b // a for a, b in itertools.pairwise(counts)] == [2] * (len(counts) - 1)


def test_meshes_follow_the_models_own_numbers(scene: Path, tmp_path: Path) -> None:
    assert mesh_overrides(scene, [], 2.0) == ["objects.0.model.resolution=[9, 7]"]
    x = {"x": np.zeros((1, 3)), "v": np.zeros((1, 3)), "m": np.ones(1), "pinned": np.zeros(1, bool)}
    none = {"springs": np.zeros((0, 2), int), "k": np.zeros(0), "rest": np.zeros(0), "c": np.zeros(0)}
    np.savez(tmp_path / "one.npz", **x, **none)  # type: ignore[arg-type]
    net = tmp_path / "net.yaml"
    net.write_text(SCENE[: SCENE.index("objects")] + "objects: [{name: one, model: {plugin: net, file: one.npz}}]\n")
    settings, omissions = settings_of(net, [])
    assert {setting.axis for setting in settings} == {"stiffness"}
    assert omissions == ["the map over mesh sizes: the model net has no resolution"]
    kept = SweepFile(tmp_path / "rows.jsonl", {}, False, print)
    points, _ = measure_all(settings[:1], ["rk4"], kept, 9.0, Executor(), lambda text: None)
    assert {point.axis for point in points} == {"stiffness"}


def test_an_interrupted_sweep_goes_on_where_it_was(scene: Path, tmp_path: Path) -> None:
    settings = [s for s in settings_of(scene, [])[0] if s.value in (1.0, 0.1)]
    told: list[str] = []

    def sweep(resume: bool, identity: str = "a") -> list[MapPoint]:
        told.clear()
        kept = SweepFile(tmp_path / "rows.jsonl", {"of": identity}, resume, print)
        return measure_all(settings, ["leapfrog"], kept, 60.0, Executor(), told.append)[0]

    whole = sweep(False)
    assert len(told) == 4, "two solvers that compile, and two rows"
    assert told[1] == "compiling, where that has not been done: leapfrog, 2 of 2"
    lines = (tmp_path / "rows.jsonl").read_text().splitlines()
    (tmp_path / "rows.jsonl").write_text("\n".join(lines[:2]) + "\n" + lines[2][:50])
    again = sweep(True)
    assert len(told) == 3, "the row that was whole is not measured again"
    outcomes = [sorted((p.axis, p.value, p.dt, p.outcome) for p in points) for points in (whole, again)]
    assert outcomes[0] == outcomes[1]
    with pytest.raises(BadInput, match="another sweep"):
        sweep(True, "b")


def test_what_the_budget_leaves_out_is_named(scene: Path, tmp_path: Path) -> None:
    settings = settings_of(scene, [])[0][:1]
    kept = SweepFile(tmp_path / "rows.jsonl", {}, False, print)
    named = "within 1e-09 s (stiffness x 1, leapfrog: the budget of time): give a longer --budget"
    with pytest.raises(RunFailed, match=re.escape(named)):
        measure_all(settings, ["leapfrog"], kept, 1e-9, Executor(), lambda text: None)


def test_tables_count_points_on_either_side_of_the_limit() -> None:
    outcomes = ("diverged", "drifting", "exact", "left out")
    points = [
        MapPoint("stiffness", value, 0.1, "rk4", 0.03, 0.1 / 2**i, outcome)
        for value in (1.0, 10.0)
        for i, outcome in enumerate(outcomes)
    ]
    assert stability.counts(points).rows == [["stiffness", "rk4", "2", "0", "0", "2", "2", "0", "2"]]
    assert stability.beyond(points).rows == [["rk4", "0 of 2", "2 of 4"]]


def test_every_class_has_a_colour_of_its_own_lightness() -> None:
    def lightness(colour: str) -> float:
        red, green, blue = (int(colour[i : i + 2], 16) / 255.0 for i in (1, 3, 5))
        return 0.2126 * red**2.2 + 0.7152 * green**2.2 + 0.0722 * blue**2.2

    known = sorted(lightness(colour) for colour in stability.COLOURS.values())
    assert np.diff(known).min() > 0.02


@pytest.mark.full
def test_the_command_writes_page_table_and_data(scene: Path, tmp_path: Path, capsys: Any) -> None:
    pytest.importorskip("matplotlib")
    flags = ["--solvers", "leapfrog,tr_bdf2", "--budget", "4", "--jobs", "1", "--out", str(tmp_path / "out")]
    flags += ["--rrd", str(tmp_path / "maps.rrd")]
    assert main(["bench", "stability", str(scene), *flags]) == 0
    assert (tmp_path / "maps.rrd").stat().st_size > 0
    said = capsys.readouterr().out
    assert "stiffness  leapfrog" in said
    data = json.loads((tmp_path / "out" / "stability-small.json").read_text())
    with (tmp_path / "out" / "stability-small.csv").open() as stream:
        lines = list(csv.DictReader(stream))
    assert len(lines) == len(data["points"])
    assert {line["solver"] for line in lines} == {"leapfrog", "tr_bdf2"}
    page = (tmp_path / "out" / "stability-small.html").read_text()
    assert page.count("<svg") == 2
    assert "http://" not in page.replace("http://www.w3.org", "")


def test_bad_arguments_are_refused_before_anything_runs(scene: Path, tmp_path: Path, capsys: Any) -> None:
    for flags, word in (
        (["--solvers", "leapfog"], "leapfrog"),
        (["--budget", "0"], "budget"),
        (["--jobs", "0"], "at least one"),
        (["--jobs", "2", "--dask", "tcp://127.0.0.1:1"], "either --jobs or --dask"),
        (["--resume"], "no sweep to go on with"),
        (["nowhere"], "nowhere"),
        (["dye/fig8a"], "of cloth that moves"),
    ):
        assert main(["bench", "stability", str(scene), *flags, "--out", str(tmp_path / "out")]) == 2
        assert word in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


SMALL = ("duration=0.2", "objects.0.model.columns=12", "objects.0.model.rows=5")


def trace(integrator: str, split: bool = True, depth: float = 1e-3, grow: float = 1.0, us: float = 10.0) -> Trace:
    """A run of 11 frames that starts with 2 J, is `depth` [m] deep and takes `us` a step, give or
    take a twentieth; its garment is lifted by its own size with 2 J.
    """
    t, seconds = np.linspace(0.0, 1.0, 11), tuple(us * 1e-4 * part for part in (1.0, 0.95, 1.05))
    series = {name: np.zeros(11) for name in SERIES} | {"t": t, "penetration": np.full(11, depth)}
    series["energy"], series["distance"], series["kinetic"] = 2.0 * grow**t, 0.1 * grow**t, np.ones(11)
    return Trace(integrator, split, series, None, "", seconds, 100, 2e-3, 3e-3, 2.0)


@pytest.mark.parametrize("height", [-3.0, 0.0, 50.0])
def test_runaway_is_growth_wherever_height_zero_is(height: float) -> None:
    def run(grow: float) -> Trace:
        found = trace("euler", grow=grow)
        found.series["energy"] += height
        return found

    assert run(1.0).runaway is None
    assert run(10.9).runaway is None  # 2 J to 21.8 J: less than 10 times 2 J more
    assert run(10**2.4).runaway == pytest.approx(0.5)  # 2 (10^(2.4 t) - 1) passes 20 at t = 0.434
    assert replace(run(1e6), lift=0.0).runaway is None


def test_a_run_that_is_no_longer_finite_has_run_away() -> None:
    lost = trace("euler")
    lost.series["energy"][7:] = np.nan
    assert lost.runaway == pytest.approx(0.7)


@pytest.mark.full
def test_same_run_twice_is_the_same_and_bones_differ_in_pieces() -> None:
    path = shipped.find("skirt-paper")
    runs = [
        run_variant(scene_file.read(path, [*SMALL, f"{SPLIT}={split}"]), "symplectic_euler", split == "true")
        for split in ("true", "true", "false")
    ]
    for name in SERIES:
        assert np.array_equal(runs[0].series[name], runs[1].series[name]), name
    assert not np.array_equal(runs[0].series["distance"], runs[2].series["distance"])
    assert runs[0].steps == 100
    kinds = [runs[0].series[name] for name in ("kinetic", "gravitational", "springs", "hinges")]
    np.testing.assert_allclose(runs[0].series["energy"], np.sum(kinds, axis=0), rtol=1e-14)


def test_files_hold_every_frame(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    traces = [trace("symplectic_euler"), trace("euler", grow=1e6), trace("euler", split=False, grow=1e6)]
    traces += [trace("symplectic_euler", split=False)]
    runs = {name: trace("symplectic_euler") for name in ("symplectic_euler", "euler", "rk4", "rk4_printed", WHOLE)}
    cells = [Cell(Setting(1.0, 0.5, 1.0, 2e-3), runs)]
    report("small", traces, cells, {"command": "nuno"}).write_beside(tmp_path / "out" / "small")
    with (tmp_path / "out" / "small.csv").open() as stream:
        rows = list(csv.DictReader(stream))
    assert len(rows) == 4 * 11
    assert float(rows[11]["energy"]) == 2.0
    data = json.loads((tmp_path / "out" / "small.json").read_text())
    assert [len(run["series"]["energy"]) for run in data["runs"]] == 4 * [11]
    assert data["runs"][1]["series"]["energy"][0] == 2.0
    assert [(run["integrator"], run["split"]) for run in data["runs"]] == [
        (one.integrator, one.split) for one in traces
    ]
    said = unescape((tmp_path / "out" / "small.html").read_text())
    assert said.count("<svg") == 3
    assert all(text in said for row in regions(cells).rows for text in row)


def cell(damping: float, **runs: Trace) -> Cell:
    """A setting at which all methods move as symplectic Euler, but for `runs`."""
    same = {name: trace("symplectic_euler") for name in ("symplectic_euler", "euler", "rk4", "rk4_printed", WHOLE)}
    return Cell(Setting(1.0, damping, 1.0, 2e-3), same | runs)


def test_the_map_counts_the_settings_at_which_each_sentence_holds() -> None:
    lost = replace(trace("symplectic_euler"), ended=0.5)
    whole = {WHOLE: trace("symplectic_euler", us=5.0)}
    cells = [cell(0.5), cell(2.0, symplectic_euler=lost, euler=trace("euler", grow=1e6)),
             cell(8.0, rk4=trace("rk4", depth=5e-3, us=40.0), **whole)]  # fmt: skip
    counts = {row[0]: row[1] for row in regions(cells).rows}
    assert counts == {
        "symplectic Euler survives": "2 of 3", "explicit Euler survives": "2 of 3",
        "it survives and moves violently": "0 of 3", "and cloth leaves the body": "0 of 3",
        "by Runge-Kutta cloth sinks in deeper": "1 of 3", "so it does by Runge-Kutta as printed": "0 of 3",
        "whole bones let cloth deeper into the body": "0 of 3", "a step of Runge-Kutta takes longer": "1 of 3",
        "so does one with bones in pieces": "1 of 3",
    }  # fmt: skip
