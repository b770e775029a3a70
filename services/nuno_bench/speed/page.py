"""The page of `nuno bench speed`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from nuno_bench import machine
from nuno_bench.report import page, plots
from nuno_bench.report.result import HEADINGS, Result, rows
from nuno_bench.speed.steps.explicit import UNIT

LEAD = (
    "Medians over repeats with the smallest and the largest sample. "
    "The first call, which compiles or loads, is in none of them."
)

OF_LIMIT = (
    "Of limit: the share of what this machine's reciprocal square roots allow; of dye, its memory at a step a pass."
)


def write_page(path: Path, results: Sequence[Result], about: dict[str, str], summary: str) -> None:
    """Write the table of all results and a figure of the rates."""
    sections: list[tuple[str, Sequence[page.Part]]] = [("", [summary + "."])]
    rates = [result for result in results if result.unit == UNIT]
    if rates:
        svg = plots.bars(
            [f"{r.case}: {r.what}" for r in rates],
            [r.samples for r in rates],
            [(r.bar, r.aim) for r in rates],
            "million vertex-steps/s",
        )
        caption = "The explicit step by itself. Upright line: the bar; dotted: the aim; thin line across: all samples."
        sections.append(("Kernels", [page.Figure(svg, caption)]))
    sections.append(
        (
            "All figures",
            [page.Table(HEADINGS, rows(results), OF_LIMIT)],
        )
    )
    notes = [[r.case, r.what, r.failure or r.note] for r in results if r.failure or r.note]
    if notes:
        sections.append(("Notes", [page.Table(("case", "what", "note"), notes, "Sizes, and what failed.", prose=True)]))
    sections.append(("Made by", [page.Facts({"command": machine.command(), **about})]))
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(page.render("Speed", LEAD, sections), encoding="utf-8")
