"""Shipped scenes of cloth that meets cloth: run, drawn, counted, and held beside what others have published."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from nuno.exports.cloth import read_frame
from nuno.exports.pictures import export_picture
from nuno.recording.reader import Recording
from nuno.scene.scene_file import Loaded
from nuno_bench.gallery.kind import Gallery, ShownScene, find_scenes, show_scene
from nuno_bench.report.page import Table, number
from nuno_schemas.colour import read_rgb
from nuno_schemas.pictures import Picture

SIZE = (640, 480)
SHARES = {"at a third": 1 / 3, "at two thirds": 2 / 3, "at the end": 1.0}
"""Moments that are drawn, as shares of the frames there are."""

VERTICES, CONTACTS, CROSSED = "vertices", "contacts at the end", "frames with a crossing"
CUT, STRETCH, SECONDS = "steps of vertices cut short [1/million]", "largest stretch [%]", "steps of a frame [s]"
MEASURES = (VERTICES, CONTACTS, CROSSED, CUT, STRETCH, SECONDS)

PPF, PPF_2025 = "ppf, NVIDIA L4", "ppf of 2025, NVIDIA L4"
PUBLISHED = {
    "cards": f"{PPF}: 9.4 k vertices, 1.5 s; Newton, RTX 3080: does not settle",
    "five-sheets": f"{PPF}: 82 k vertices, 1.6 s",
    "knot": f"{PPF}: 19.6 k vertices, 0.84 s",
    "ribbon": f"{PPF_2025}: 34.9 k vertices, 1.7 s",
    "twist": f"{PPF_2025}: 203 k vertices, 6.6 s",
}
"""Seconds a frame of a scene of this kind in the README of ppf-contact-solver (Ando, ACM TOG 43(6), 2024), whose frames
are a sixtieth of a second, too; it became about twice as fast in 2026. Newton's is from
newton-physics/newton#3494.
"""


def look(loaded: Loaded, recording: Recording, folder: Path) -> tuple[list[tuple[str, Picture]], dict[str, float]]:
    """Draw its moments, by way of a file in a folder, and measure its run."""
    last = read_frame(recording)
    found = []
    for label, share in SHARES.items():
        frame = read_frame(recording, round(share * last.number))
        picture = export_picture(recording, folder / "picture.png", frame.number, SIZE, "cloth")
        found.append((f"{label}, {frame.t:.3g} s", read_rgb(picture)))
    return found, measure(recording.report())


def measure(report: Mapping[str, Any]) -> dict[str, float]:
    """From a run's report; nothing of a run that did not end by itself."""
    if not report:
        return {}
    frames, counts = report["frames"]["sent"] - 1, report["counts"]
    steps = report["totals"].get("steps") or report["steps_per_frame"] * (frames - report["idle"])
    return {
        VERTICES: report["size"]["vertices"],
        CONTACTS: counts.get("cloth_contacts", 0),
        CROSSED: report["cloth_contact"]["crossed"],
        CUT: 1e6 * counts.get("cut_short", 0) / (max(steps, 1) * report["size"]["vertices"]),
        STRETCH: 100.0 * report["stretch"],
        SECONDS: report["parts_seconds"].get("steps", 0.0) / max(frames, 1),
    }


def table(shown: Sequence[ShownScene]) -> Table:
    """A row a scene."""
    rows = [
        [one.name, *(number(one.measured[name]) for name in MEASURES), PUBLISHED.get(one.name, "")]
        for one in shown if one.measured
    ]  # fmt: skip
    return Table(("scene", *MEASURES, "published, a frame"), rows)


KIND = Gallery(
    title="Cloth meets cloth",
    lead="The scenes of cloth contact that come with nuno, most of them known from others' work.",
    scenes=partial(find_scenes, "contact"),
    run_scene=partial(show_scene, look=look),
    measures="Each scene as it is shipped, which is coarser than what was published. Steps are counted for each "
    "vertex.",
    table=table,
)
