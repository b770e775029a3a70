"""Scenes of the dye paper's figures: run, drawn, and measured against what the paper says of them."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from nuno.dye.run import DyeRun
from nuno.export.dyed import DyePainter, painter_of
from nuno.scene import scene_file
from nuno.scene.scene_file import Loaded
from nuno_bench.gallery.dye_measures import Dyed, fixed_radius, follows, mottle, spread_radius, streaks
from nuno_bench.gallery.kind import EFFECT, Columns, Kind, Shown, difference_row
from nuno_bench.machine import cores
from nuno_bench.report.result import number
from nuno_schemas.dye_picture import Layers, Picture, amount_seen
from nuno_schemas.look import DyeView

SIDE = 480
"""Pixels of a picture, about."""
SEEN_FIXED = ("fig9a", "fig9b", "fig9c")
"""Scenes that the paper shows by what fibre has taken, too."""
MOMENTS = {"fig12": (0, 1, 2, 4, 8, 16, 24, 32)}
"""Frames that are shown of a scene; of others the last one is."""
FIXED, DARKER = "fixed dye alone, twice as dark", 2.0
"""What a picture of it is called, and by how much it is darker: it is never more than a half of all."""

PARAMETER_HEADINGS = ("scene", "I", "II", "III", "V", "tau 2", "tau 1", "P", "varied", "weave", "cells", "yarn, gap")
DYE_HEADINGS = ("scene", "D0 [mm^2/h]", "D_ab / D0", "isotherm", "given", "for [h]", "darkest")
NUMBER_HEADINGS = ("scene", "solver", "steps", "time [s]", "M cell updates/s", "supplied", "mobile", "fixed", "balance")


class Difference(NamedTuple):
    """Something that the paper says: a measure of one scene is above that of another."""

    says: str
    measure: Callable[[Dyed], float]
    high: str
    low: str


DIFFERENCES = (
    Difference("fixed dye stays near the drop", spread_radius, "fig8a", "fig8b"),
    Difference("cloth is mottled", mottle, "fig8d", "fig8a"),
    Difference("yarns differ more by their room than by porosity and twist", mottle, "fig8f-text", "fig8e-text"),
    Difference("so do narrow ones", mottle, "fig8g-text", "fig8e-text"),
    Difference("narrow yarns show as streaks", streaks, "fig8g-text", "fig8f-text"),
    Difference("by Freundlich it spreads wider", fixed_radius, "fig9b", "fig9a"),
    Difference("by Langmuir it stays nearer", fixed_radius, "fig9a", "fig9c"),
)
WEAVES = ("fig10a", "fig10b", "fig10c")
"""Each of them must follow its own weave more than the others do."""


def scenes() -> dict[str, Path]:
    """Files of the paper's figures by name, in their order."""
    figures = [path for path in scene_file.shipped("dye").values() if path.stem.startswith("fig")]
    return {path.stem: path for path in sorted(figures, key=_order)}


def _order(path: Path) -> tuple[int, str]:
    return figure_of(path.stem), path.stem


def figure_of(name: str) -> int:
    """The number of the figure that a scene belongs to."""
    return int("".join(c for c in name.removeprefix("fig").partition("-")[0] if c.isdigit()))


def run_scene(path: Path) -> Shown[Dyed]:
    """Run one to its end, or to where it fails. Raises BadInput."""
    loaded = scene_file.read(path)
    name, frames = loaded.scene.name, loaded.scene.frames
    run = DyeRun(loaded, cores())
    painter = painter_of(loaded, SIDE)
    cells = run.cells
    painter.prepare(Layers(cells.fibre, cells.up, cells.v_max, cells.yarns, cells.photograph), cells.size)
    moments = MOMENTS.get(name, (frames,))
    pictures = [("at the start", _draw(painter, run))] if 0 in moments else []
    report, seconds, balance, failed = run.measure(), 0.0, 0.0, ""
    while not run.finished and not failed:
        begin = time.perf_counter()
        frame = run.advance()
        seconds += time.perf_counter() - begin
        report, balance = frame.report, max(balance, run.balance(frame.report))
        failed = "" if report.status == "ok" else report.message
        if frame.number in moments:
            pictures.append(("" if moments == (frames,) else f"after {run.time / 3600:g} h", _draw(painter, run)))
    if name in SEEN_FIXED:
        pictures.append((FIXED, _draw(painter, run, "fixed")))
    steps = run.frame * run.steps
    numbers = [
        name, _solver(loaded, run), f"{steps:,}", f"{seconds:.3g}",
        f"{steps * cells.fibre.size / max(seconds, 1e-9) * 1e-6:.3g}",
        *(number(sum(values)) for values in (run.supplied, report.mobile, report.fixed)),
        f"{balance:.1e}" if balance else "0",
    ]  # fmt: skip
    dyed = Dyed(cells, run.state.phi[0], run.state.fixed[0], _pitch(loaded))
    parameters = [_parameters(loaded), _dyes(loaded)]
    return Shown(name, loaded.scene.description, pictures, parameters, numbers, dyed, failed)


def _draw(painter: DyePainter, run: DyeRun, view: DyeView = "all") -> Picture:
    amounts = amount_seen(run.state.phi, run.state.fixed, view) * (DARKER if view == "fixed" else 1.0)
    picture: Picture = painter.chosen.plugin.draw(painter.prepared, amounts)
    return picture


def _solver(loaded: Loaded, run: DyeRun) -> str:
    return f"{loaded.dye.solver.name if loaded.dye else ''}, {run.dt:.4g} s"


def _pitch(loaded: Loaded) -> int:
    """Of the warp [cells], 1 where a cloth has no such number."""
    yarn = _config(loaded).get("warp", {})
    return int(yarn.get("width", 1)) + int(yarn.get("gap", 0))


def _config(loaded: Loaded) -> dict[str, Any]:
    return loaded.dye.cloth.config.model_dump() if loaded.dye is not None else {}


def _parameters(loaded: Loaded) -> list[str]:
    config = _config(loaded)
    tau, yarn, vary = config["tau3"], config["warp"], config.get("vary")
    weave, cells = config.get("weave"), config.get("cells")
    varied = f"{', '.join(vary['of'])} r, {vary['low']:g} to {vary['high']:g}" if vary else ""
    return [
        loaded.scene.name, *(f"{tau[kind]:g}" if kind in tau else "" for kind in ("I", "II", "III", "V")),
        f"{config['tau2']:g}", f"{yarn['twist']:g}", f"{yarn['porosity']:g}", varied,
        str(weave["plugin"]) if weave else "of the photograph",
        f"{cells[0]} x {cells[1]} x 2" if cells else "",
        f"{yarn['width']}, {yarn['gap']}" if "width" in yarn else "",
    ]  # fmt: skip


def _dyes(loaded: Loaded) -> list[str]:
    """What is dyed with, how and how long; of several dyes one after the other."""
    dye, scene = loaded.scene.dye, loaded.scene
    if dye is None or loaded.dye is None:
        return [scene.name, *[""] * (len(DYE_HEADINGS) - 1)]
    laws = (one.isotherm for one in dye.dyes if one.isotherm is not None)
    given = (f"{one['kind']}{', kept up' if one['maintained'] else ''}" for one in _config(loaded)["supply"])
    return [
        scene.name, *("; ".join(f"{value:g}" for value in values) for values in (
            [one.D0 * 3.6e9 for one in dye.dyes], [one.adsorption for one in dye.dyes],
        )),
        "; ".join(" ".join([law.plugin, *(f"{name} {value:g}" for name, value in law.config.items())]) for law in laws),
        "; ".join(f"{n} x {what}" if n > 1 else what for what, n in Counter(given).items()),
        f"{scene.duration * dye.speed / 3600.0:g}", "; ".join(f"{one.colour.full:g}" for one in dye.dyes),
    ]  # fmt: skip


def compare(shown: Mapping[str, Shown[Dyed]]) -> list[list[str]]:
    """Rows under DIFFERENCE_HEADINGS, of those differences whose scenes have all been run."""
    rows = []
    for one in DIFFERENCES:
        if one.high in shown and one.low in shown:
            high, low = ((name, one.measure(shown[name].measured)) for name in (one.high, one.low))
            rows.append(difference_row(one.says, one.measure.__name__.replace("_", " "), high, low))
    if all(name in shown for name in WEAVES):
        for name in WEAVES:
            weave = shown[name].measured.cells
            own = follows(shown[name].measured, weave)
            found, other = max((follows(shown[rest].measured, weave), rest) for rest in WEAVES if rest != name)
            measure = f"follows that of {name}"
            rows.append(difference_row("each weave has its own pattern", measure, (name, own), (other, found)))
    return rows


KIND = Kind(
    title="Dyed cloth",
    lead="The figures of the dye paper, each from its row of the paper's table, and where its text says otherwise, "
    "from the text too.",
    scenes=scenes,
    run_scene=run_scene,
    compare=compare,
    parameters=(
        Columns(
            PARAMETER_HEADINGS,
            "tau 3 by kind of face (I to V; IV is 1), tau 2, tau 1 and P of the yarns, r at random for each yarn, "
            "weave, cells, and yarn and gap in cells.",
        ),
        Columns(
            DYE_HEADINGS,
            "D0 in water, how fast fibre fixes dye and by which isotherm, what was given, for how long it spreads, and "
            "the amount that is drawn darkest. The paper prints no constants of isotherms.",
        ),
    ),
    numbers=Columns(
        NUMBER_HEADINGS,
        "Balance: how far mobile and fixed dye are from what was supplied, at worst, as a share of it.",
    ),
    differences="Every difference that the paper describes, as a ratio of two measures; at least "
    f"{EFFECT:g} is asked for.",
    section=lambda name: f"Figure {figure_of(name)}",
    apart=FIXED,
)
