"""Scenes of the dye paper's figures: run, drawn, and measured against what the paper says of them."""

from __future__ import annotations

from pathlib import Path

from nuno.dye.painter import DyePainter
from nuno.dye.run import DyeRun
from nuno.scene import scene_file, shipped
from nuno.scene.scene_file import Loaded
from nuno_bench.gallery.dye_measures import Dyed, fixed_radius, follows, mottle, spread_radius, streaks
from nuno_bench.gallery.kind import Difference, Kind, Shown
from nuno_bench.machine import cores
from nuno_schemas.dye import Cells
from nuno_schemas.dye_picture import Picture, amount_seen
from nuno_schemas.look import DyeView

SIDE = 480
"""Pixels of a picture, about."""
SEEN_FIXED = ("fig9a", "fig9b", "fig9c")
"""Scenes that the paper shows by what fibre has taken, too."""
MOMENTS = {"fig12": (0, 1, 2, 4, 8, 16, 24, 32)}
"""Frames that are shown of a scene; of others the last one is."""
FIXED, DARKER = "fixed dye alone, twice as dark", 2.0
"""What a picture of it is called, and by how much it is darker: it is never more than a half of all."""
WEAVES = ("fig10a", "fig10b", "fig10c")
"""Each of them must follow its own weave more than the others do."""
RADIUS, FIXED_RADIUS = "spread of all dye [m]", "radius of fixed dye [m]"
MOTTLE, STREAKS, BALANCE = "mottle", "streaks", "worst balance over what was supplied"
FOLLOWS = "follows the weave of {}"
DIFFERENCES = (
    Difference("fixed dye stays near the drop", ("fig8a", RADIUS), ("fig8b", RADIUS)),
    Difference("cloth is mottled", ("fig8d", MOTTLE), ("fig8a", MOTTLE)),
    Difference("yarns differ more by their room than by porosity and twist", ("fig8f-text", MOTTLE),
               ("fig8e-text", MOTTLE)),
    Difference("so do narrow ones", ("fig8g-text", MOTTLE), ("fig8e-text", MOTTLE)),
    Difference("narrow yarns show as streaks", ("fig8g-text", STREAKS), ("fig8f-text", STREAKS)),
    Difference("by Freundlich it spreads wider", ("fig9b", FIXED_RADIUS), ("fig9a", FIXED_RADIUS)),
    Difference("by Langmuir it stays nearer", ("fig9a", FIXED_RADIUS), ("fig9c", FIXED_RADIUS)),
    *(
        Difference("each weave has its own pattern", (own, FOLLOWS.format(own)), (other, FOLLOWS.format(own)))
        for own in WEAVES for other in WEAVES if other != own
    ),
)  # fmt: skip


def scenes() -> dict[str, Path]:
    """Files of the paper's figures by name, in their order."""
    figures = [path for path in shipped.scenes("dye").values() if path.stem.startswith("fig")]
    return {path.stem: path for path in sorted(figures, key=lambda path: (figure_of(path.stem), path.stem))}


def figure_of(name: str) -> int:
    """The number of the figure that a scene belongs to."""
    return int("".join(c for c in name.removeprefix("fig").partition("-")[0] if c.isdigit()))


def run_scene(path: Path) -> Shown:
    """Run one to its end, or to where it fails. Raises BadInput."""
    loaded = scene_file.read(path)
    name, frames = loaded.scene.name, loaded.scene.frames
    run, painter = DyeRun(loaded, cores()), DyePainter(loaded, SIDE)
    cells = run.cells
    painter.prepare(cells, cells.size)
    moments = MOMENTS.get(name, (frames,))
    pictures = [("at the start", _draw(painter, run))] if 0 in moments else []
    balance, failed = 0.0, ""
    while not run.finished and not failed:
        frame = run.advance()
        balance = max(balance, run.balance(frame.report))
        failed = "" if frame.report.status == "ok" else frame.report.message
        if frame.number in moments:
            pictures.append(("" if moments == (frames,) else f"after {run.time / 3600:g} h", _draw(painter, run)))
    if name in SEEN_FIXED:
        pictures.append((FIXED, _draw(painter, run, "fixed")))
    dyed = Dyed(cells, run.state.phi[0], run.state.fixed[0], _pitch(loaded))
    return Shown(name, loaded.scene.description, pictures, {BALANCE: balance} | _measure(name, dyed), failed)


def _measure(name: str, dyed: Dyed) -> dict[str, float]:
    """What the differences ask of a scene."""
    own = {RADIUS: spread_radius, FIXED_RADIUS: fixed_radius, MOTTLE: mottle, STREAKS: streaks}
    asked = dict.fromkeys(m for each in DIFFERENCES for scene, m in (each.high, each.low) if scene == name)
    found = {measure: own[measure](dyed) for measure in asked if measure in own}
    if name in WEAVES:
        found |= {FOLLOWS.format(weave): follows(dyed, cells_of(scenes()[weave])) for weave in WEAVES}
    return found


def cells_of(path: Path) -> Cells:
    """The cloth of a scene before it is dyed."""
    return DyeRun(scene_file.read(path), 1).cells


def _draw(painter: DyePainter, run: DyeRun, view: DyeView = "all") -> Picture:
    amounts = amount_seen(run.state.phi, run.state.fixed, view) * (DARKER if view == "fixed" else 1.0)
    picture: Picture = painter.chosen.plugin.draw(painter.prepared, amounts)
    return picture


def _pitch(loaded: Loaded) -> int:
    """Of the warp [cells], 1 where a cloth has no such number."""
    yarn = loaded.dye.cloth.config.model_dump().get("warp", {}) if loaded.dye is not None else {}
    return int(yarn.get("width", 1)) + int(yarn.get("gap", 0))


KIND = Kind(
    title="Dyed cloth",
    lead="The figures of the dye paper, each from its row of the paper's table, and where its text says otherwise, "
    "from the text too.",
    scenes=scenes,
    run_scene=run_scene,
    differences=DIFFERENCES,
    measures="What the paper's differences are measured by, and how far mobile and fixed dye are from what was "
    "supplied, at worst, as a share of it.",
    section=lambda name: f"Figure {figure_of(name)}",
    apart=FIXED,
)
