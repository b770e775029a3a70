"""The bench's fits of stockings: to rest or not at all, and their section of a page."""

from __future__ import annotations

from pathlib import Path

import pytest

from nuno.cli import main
from nuno_bench.report.page import Result, marks
from nuno_bench.speed import command as speed
from nuno_bench.speed import leg as fit_speed
from nuno_bench.speed.leg import fit

SMALL = ("objects.stocking.model.wales=10", "objects.stocking.model.courses=19", "bodies.leg.collider.resolution=16")


@pytest.mark.full
def test_a_fit_ends_at_rest_and_one_that_does_not_is_no_figure() -> None:
    taken, steps = fit("stocking-150", *SMALL)
    assert steps > 10 and taken > 0.0
    assert fit("stocking-150", *SMALL, frames=1)[1] == 10
    with pytest.raises(RuntimeError, match="did not come to rest"):
        fit("stocking-150", *SMALL, "duration=0.2")


def test_every_stocking_is_fitted_on_both_legs_against_its_bar(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[tuple[object, ...]] = []

    def quick(name: str, *overrides: str, frames: int | None = None) -> tuple[float, int]:
        asked.append((name, *overrides, frames))
        return 3.0, 30

    monkeypatch.setattr(fit_speed, "fit", quick)
    results = fit_speed.fits(7)
    assert [(one.bar, one.median, len(one.samples)) for one in results] == [(bar, 3.0, 3) for bar in (15, 15, 90, 90)]
    assert len(asked) == 4 * 4 and len(set(asked)) == 4 * 2


def test_chosen_cases_have_a_section_of_their_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    page = tmp_path / "page.md"
    page.write_text("".join(f"{mark}\n" for name in ("speed", "speed fit") for mark in marks(name)))
    monkeypatch.setattr(speed, "run_case", lambda name, repeats: [Result(name, "seconds", "s", (1.0,))])
    assert main(["bench", "speed", "fit", "--docs", str(page)]) == 0
    text = page.read_text()
    assert "| fit |" in text.split("speed fit -->")[1] and "| fit |" not in text.split("<!-- end: speed -->")[0]
