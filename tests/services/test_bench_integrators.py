"""The comparison of integrators: what is recorded of a run, and what is said about it."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from html import unescape
from pathlib import Path

import numpy as np
import pytest

from nuno.scene import scene_file, shipped
from nuno_bench.integrators import SERIES, SPLIT, Trace, compare_with_paper, report, run_variant

SMALL = ("duration=0.2", "objects.0.model.columns=12", "objects.0.model.rows=5")


def trace(integrator: str, split: bool = True, depth: float = 1e-3, grow: float = 1.0, us: float = 10.0) -> Trace:
    """A run of 11 frames that starts with 2 J, is `depth` [m] deep and takes `us` a step, give or
    take a twentieth; its garment is lifted by its own size with 2 J.
    """
    t, seconds = np.linspace(0.0, 1.0, 11), tuple(us * 1e-4 * part for part in (1.0, 0.95, 1.05))
    series = {name: np.zeros(11) for name in SERIES} | {"t": t, "penetration": np.full(11, depth)}
    series["energy"], series["distance"] = 2.0 * grow**t, 0.1 * grow**t
    return Trace(integrator, split, series, None, "", seconds, 100, 2e-3, 3e-3, 1e-4, 20, 2.0)


def verdicts(*traces: Trace) -> dict[str, str]:
    return {found.claim.split(",")[0][:24]: found.verdict for found in compare_with_paper(traces)}


def test_verdicts_follow_from_the_runs() -> None:
    calm = trace("symplectic_euler")
    wild = verdicts(calm, trace("euler", grow=1e6), trace("rk4", depth=5e-3, us=40.0))
    tame = verdicts(calm, trace("euler"), trace("rk4", us=10.0))
    assert list(wild.values()) == ["agrees"] * 4
    assert list(tame.values()) == ["agrees", *["contradicts"] * 3]


def test_bones_are_compared_method_by_method() -> None:
    slower = verdicts(trace("symplectic_euler", us=15.0), trace("symplectic_euler", split=False, us=10.0))
    same = verdicts(trace("symplectic_euler"), trace("symplectic_euler", split=False))
    assert list(slower.values()) == ["agrees", "agrees"]
    assert list(same.values()) == ["agrees", "contradicts"]


def slower(ours: tuple[float, ...], theirs: tuple[float, ...]) -> str:
    """Whether the paper's "Runge-Kutta is slower" holds, for times of each round, and the words."""
    runs = [replace(trace(name), seconds=times) for name, times in (("symplectic_euler", theirs), ("rk4", ours))]
    found = next(one for one in compare_with_paper(runs) if "slower" in one.claim)
    return found.verdict


def test_times_that_differ_less_than_their_repeats_are_undecided() -> None:
    assert slower((4.0, 5.0, 3.0), (1.0, 1.0, 1.0)) == "agrees"
    assert slower((1.0, 1.05, 1.0), (1.0, 1.0, 1.0)) == "contradicts"
    assert slower((1.3, 1.0, 1.3), (1.0, 1.0, 1.0)) == "undecided"
    # A machine that slows down as a whole parts no pair; one round tells nothing of its spread.
    assert slower((1.5, 3.0, 6.0), (1.0, 2.0, 4.0)) == "agrees"
    assert slower((4.0,), (1.0,)) == "undecided"


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
    assert runs[0].primitives > runs[2].primitives
    assert runs[0].steps == 100
    kinds = [runs[0].series[name] for name in ("kinetic", "gravitational", "springs", "hinges")]
    np.testing.assert_allclose(runs[0].series["energy"], np.sum(kinds, axis=0), rtol=1e-14)


def test_files_hold_every_frame(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    traces = [trace("symplectic_euler"), trace("euler", grow=1e6), trace("euler", split=False, grow=1e6)]
    traces += [trace("symplectic_euler", split=False)]
    found = compare_with_paper(traces)
    report("small", traces, {"command": "nuno"}).write_beside(tmp_path / "out" / "small")
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
    assert said.count("<svg") == 2
    assert all(one.seen in said for one in found)
