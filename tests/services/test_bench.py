"""What the benchmarks time and say: the peer does the same work, verdicts follow from the figures."""

from __future__ import annotations

import re
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numba
import numpy as np
import pytest

from nuno.cli import main
from nuno.plugin_contract import registry
from nuno_bench.problem import advance_all
from nuno_bench.report import page
from nuno_bench.report.page import Report, Result
from nuno_bench.speed import command as speed
from nuno_bench.speed import steps as meshes
from nuno_bench.speed import timing
from nuno_bench.speed.steps import net, sheet
from nuno_bench.speed.timing import watch_compiler
from nuno_schemas.errors import BadInput, RunFailed
from nuno_schemas.fabric import State


@pytest.mark.parametrize(
    ("samples", "at_most", "verdict"),
    [
        ((59.0,), False, "missed"),
        ((10.0, 60.0, 61.0), False, "bar met"),
        ((90.0,), False, "aim met"),
        ((61.0,), True, "missed"),
        ((60.0,), True, "bar met"),
    ],
)
def test_verdict_follows_from_the_median(samples: tuple[float, ...], at_most: bool, verdict: str) -> None:
    aim = 20.0 if at_most else 90.0
    assert Result("case", "what", "unit", samples, bar=60.0, aim=aim, at_most=at_most).verdict == verdict


def test_failed_measurement_is_neither_met_nor_silent() -> None:
    failed = Result("case", "what", "unit", bar=1.0, failure="RunFailed: it broke")
    assert failed.verdict == "failed"
    assert speed.summary([failed]) == "0 of 1 bars met; could not be measured: case"


def test_failing_case_is_reported_and_others_go_on(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(speed.CASES, "broken", "steps:no_such_function")
    (result,) = speed.run_case("broken", 1)
    assert result.verdict == "failed"
    assert "no_such_function" in result.failure


def test_nets_of_a_sheet_move_like_the_sheet() -> None:
    """As its arrays, and with its vertices numbered at random."""
    fabric = sheet(12, 9, meshes.DAMPING)
    arrays = meshes.net_arrays(fabric, varied=False)
    mixed = net(meshes.renumbered(arrays))
    order = np.lexsort(mixed.position.T), np.lexsort(fabric.position.T)
    assert (np.argsort(order[0]) != np.argsort(order[1])).sum() > 100
    plugin = registry.load("nuno.integrators", "symplectic_euler")
    ends = []
    for one, places in ((fabric, order[1]), (net(arrays), order[1]), (mixed, order[0])):
        system, start = meshes.system_of(one)[0], meshes.system_of(fabric)[1].x[order[1]]
        state = State(np.empty_like(start), np.zeros_like(start))
        state.x[places] = start
        plugin.advance(system, state, plugin.prepare(plugin.Config(), system, state), None, 50, 1e-4)
        ends.append(state.x[places])
    np.testing.assert_allclose(ends[0], ends[1], rtol=0, atol=1e-12)
    np.testing.assert_allclose(ends[0], ends[2], rtol=0, atol=1e-12)


def test_a_first_call_is_in_no_sample_and_rates_are_work_over_time(monkeypatch: pytest.MonkeyPatch) -> None:
    calls: list[int] = []
    monkeypatch.setattr(timing, "seconds", lambda call: call() or (10.0, 0.5, 2.0)[len(calls) - 1])
    found = timing.measure("case", "what", "M/s", lambda: calls.append(1), 2, 8.0, bar=3.0, note="small")
    assert found.samples == (16.0, 4.0) and found.compile_seconds == 10.0 and found.bar == 3.0
    assert found.note == "small, 0 functions compiled"
    calls.clear()
    assert timing.measure("case", "what", "s", lambda: calls.append(1), 2).samples == (0.5, 2.0)


def test_compiler_is_watched() -> None:
    @numba.njit  # type: ignore[untyped-decorator]
    def double(x: float) -> float:
        return 2.0 * x

    for argument, compiled in ((1.0, 1), (2.0, 0), (3, 1), (4, 0)):
        with watch_compiler() as watched:
            double(argument)
        assert watched.number == compiled


def test_page_escapes_text_and_needs_nothing_from_outside() -> None:
    table = page.Table(("a", "b"), [["<script>", "1.5"], ["x", "2"]], "caption & more")
    html = page.render("A < B", "lead", [("h", [table, page.Facts({"k": "v"}), page.Figure("<svg></svg>", "c")])])
    assert "<script>" not in html
    assert "A &lt; B" in html
    assert not re.search(r"src=|href=\"(?!data:)|https?://|@import|url\(", html)


def test_figure_marks_a_curve_that_ended_early() -> None:
    plots = pytest.importorskip("nuno_bench.report.plots")
    pytest.importorskip("matplotlib")
    t = np.linspace(0.0, 1.0, 5)

    def drawn(ended: str) -> str:
        text: str = plots.draw([plots.Panel("y", [plots.Curve("a", t, t, 0, ended=ended)], "t")])
        return text

    assert plots.BAD in drawn("diverged")
    assert plots.BAD not in drawn("")
    identifiers = re.findall(r' id="([^"]+)"', drawn("diverged"))
    assert len(identifiers) == len(set(identifiers))


def test_only_the_measured_section_of_a_page_is_replaced(tmp_path: Path) -> None:
    path = tmp_path / "page.md"
    begin, end = page.marks("speed")
    path.write_text(f"before\n{begin}\nold\n{end}\nafter\n")
    for _ in range(2):
        page.replace_section(path, "speed", [page.Table(("a", "b"), [["x|y", "1"]])])
        assert path.read_text() == f"before\n{begin}\n\n| a | b |\n| --- | --- |\n| x\\|y | 1 |\n\n{end}\nafter\n"
    with pytest.raises(BadInput, match="no section"):
        page.replace_section(path, "integrators", ["new"])
    assert "new" not in path.read_text()


@pytest.mark.parametrize(
    "arguments",
    [["speed", "grid-25"], ["speed", "sheet-32", "--repeats", "0"], ["integrators", "hanging-sheet"], ["nothing"]],
)
def test_bad_arguments_are_refused(arguments: list[str], capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    """With exit code 2, before anything is measured."""
    refused: Any = main(["bench", *arguments])
    assert refused == 2
    assert "error: " in capsys.readouterr().err


def test_a_solver_that_fails_in_its_first_frame_has_taken_time() -> None:
    """A point at no time at all cannot be drawn over the logarithm of time."""

    def advance(frame: int) -> Any:
        raise RunFailed("no")

    status, _, seconds, _ = advance_all(SimpleNamespace(frames=2, frame=0.1), advance, lambda report: None, 1.0)
    assert status == "failed" and seconds > 0.0


@pytest.mark.parametrize("ending", [".html", ".json", ".csv"])
def test_a_report_that_the_disk_does_not_take_leaves_the_former_one(ending: str, tmp_path: Path) -> None:
    """A limit on the size of files stands in for a full disk."""
    resource = pytest.importorskip("resource", reason="needs limits on file sizes")
    text, rows = "x" * 300_000, [{"n": k} for k in range(100_000)]
    large = {".html": ([("", [text])], {}, ()), ".json": ([], {"text": text}, ()), ".csv": ([], {}, rows)}[ending]
    sections, data, lines = large
    report, path = Report("title", "lead", sections, {}, data, rows=lines), tmp_path / f"page{ending}"
    path.write_text("former")
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    try:
        resource.setrlimit(resource.RLIMIT_FSIZE, (200_000, before[1]))
        with pytest.raises(BadInput, match="cannot write there"):
            report.write_beside(tmp_path / "page")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert path.read_text() == "former"
    report.write_beside(tmp_path / "page")
    assert path.stat().st_size > 200_000
