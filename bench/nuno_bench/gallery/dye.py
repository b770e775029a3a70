"""Scenes of the dye paper's figures: run, drawn, and measured against what the paper says of them."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np

from nuno.dye.painter import DyePainter
from nuno.dye.run import DyeRun
from nuno.scene import scene_file, shipped
from nuno_bench.gallery.kind import Difference, Gallery, ShownScene
from nuno_bench.machine import cores
from nuno_schemas.dye import Cells
from nuno_schemas.dyeing import DyeView
from nuno_schemas.fabric import Bool, Float
from nuno_schemas.pictures import Picture, amount_seen

NEAR = 2e-3
"""Around the middle of the dye [m]: what lies farther is too pale to be judged by eye."""
SIDE = 480
"""Pixels of a picture, about."""
SEEN_FIXED = ("fig9a", "fig9b", "fig9c")
"""Scenes that the paper shows by what fibre has taken, too."""
MOMENTS = {"fig12": (0, 1, 2, 4, 8, 16, 24, 32)}
"""Frames that are shown of a scene; of others the last one is."""
FIXED, DARKER = "fixed dye alone, twice as dark", 2.0
"""Label of a picture of fixed dye, and by how much it is darker: fixed dye is at most half of all."""
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


def run_scene(path: Path) -> ShownScene:
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
    yarn = loaded.dye.cloth.config.model_dump().get("warp", {}) if loaded.dye is not None else {}
    pitch = int(yarn.get("width", 1)) + int(yarn.get("gap", 0))  # of the warp; 1 where a cloth has no such number
    dyed = Dyed(cells, run.state.phi[0], run.state.fixed[0], pitch)
    return ShownScene(name, loaded.scene.description, pictures, {BALANCE: balance} | _measure(name, dyed), failed)


def _measure(name: str, dyed: Dyed) -> dict[str, float]:
    """Measure what the differences need of a scene."""
    own = {RADIUS: spread_radius, FIXED_RADIUS: fixed_radius, MOTTLE: mottle, STREAKS: streaks}
    asked = dict.fromkeys(m for each in DIFFERENCES for scene, m in (each.high, each.low) if scene == name)
    found = {measure: own[measure](dyed) for measure in asked if measure in own}
    if name in WEAVES:
        undyed = {weave: DyeRun(scene_file.read(scenes()[weave]), 1).cells for weave in WEAVES}
        found |= {FOLLOWS.format(weave): follows(dyed, cells) for weave, cells in undyed.items()}
    return found


def _draw(painter: DyePainter, run: DyeRun, view: DyeView = "all") -> Picture:
    amounts = amount_seen(run.state.phi, run.state.fixed, view) * (DARKER if view == "fixed" else 1.0)
    picture: Picture = painter.chosen.plugin.draw(painter.prepared, amounts)
    return picture


class Dyed(NamedTuple):
    """A cloth, the amounts (2, ny, nx) of one dye in it, mobile and fixed, and the pitch of its yarns [cells]."""

    cells: Cells
    phi: Float
    fixed: Float
    pitch: int

    @property
    def shown(self) -> Float:
        """(ny, nx) all dye of the upper yarns."""
        total = self.phi + self.fixed
        upper: Float = np.where(self.cells.up[1], total[1], total[0])
        return upper


def spread_radius(dyed: Dyed) -> float:
    """Root mean square distance of all dye from its middle [m]."""
    amount = (dyed.phi + dyed.fixed).sum(axis=0)
    x, y, _ = _around(amount)
    return float(np.sqrt((amount * (x * x + y * y)).sum() / amount.sum()) * dyed.cells.size)


def fixed_radius(dyed: Dyed) -> float:
    """Radius of a disc as large as the part where fibre has fixed half of the most [m]."""
    amount = dyed.fixed.sum(axis=0)
    return float(np.sqrt((amount > 0.5 * amount.max()).sum() / np.pi) * dyed.cells.size)


def mottle(dyed: Dyed) -> float:
    """Deviation of the crossings that show from the mean of those around them, as a share of the mean amount."""
    rest, near, mean = _uneven(dyed)
    return float(rest[near].std() / mean)


def streaks(dyed: Dyed) -> float:
    """How much more the weft differs from yarn to yarn than along a yarn: a ratio of deviations, 1 for none.

    Of each crossing from the mean of its two neighbours, which a smooth spread hardly has.
    """
    weft = crossings((dyed.phi + dyed.fixed)[0], dyed.pitch)
    across = (weft[1:-1] - 0.5 * (weft[2:] + weft[:-2]))[:, 1:-1]
    along = (weft[:, 1:-1] - 0.5 * (weft[:, 2:] + weft[:, :-2]))[1:-1]
    near = _near(weft, dyed)[1:-1, 1:-1]
    return float(np.sqrt(np.square(across[near]).mean() / np.square(along[near]).mean()))


def follows(dyed: Dyed, weave: Cells) -> float:
    """How well what shows follows a weave, -1 to 1: a correlation over the crossings.

    Dye runs along yarns. To the right and left of its middle, then, crossings whose weft is above are darker
    than those around them, and above and below the middle those whose warp is.
    """
    rest, near, _ = _uneven(dyed)
    _, _, sector = _around(crossings(dyed.shown, dyed.pitch))
    warp = crossings(weave.up[1].astype(np.float64), dyed.pitch)
    lighter = (0.5 - warp) * sector
    near = near & (sector != 0.0)
    return float(np.corrcoef(rest[near], (lighter - _smooth(lighter))[near])[0, 1])


def crossings(values: Float, pitch: int) -> Float:
    """(ny / pitch, nx / pitch) means of values (ny, nx) over the crossings of yarns."""
    ny, nx = (n // pitch for n in values.shape)
    means: Float = values[: ny * pitch, : nx * pitch].reshape(ny, pitch, nx, pitch).mean(axis=(1, 3))
    return means


def _uneven(dyed: Dyed) -> tuple[Float, Bool, float]:
    """Crossings less the mean of those around them, which of them are near the dye, and their mean amount."""
    shown = crossings(dyed.shown, dyed.pitch)
    near = _near(shown, dyed)
    return shown - _smooth(shown), near, float(shown[near].mean())


def _smooth(values: Float) -> Float:
    """Means over 3 x 3 neighbours."""
    wide, (ny, nx) = np.pad(values, 1, mode="edge"), values.shape
    parts = [wide[i : i + ny, j : j + nx] for i in range(3) for j in range(3)]
    mean: Float = np.mean(parts, axis=0)
    return mean


def _near(values: Float, dyed: Dyed) -> Bool:
    x, y, _ = _around(values)
    near: Bool = np.hypot(x, y) * dyed.pitch * dyed.cells.size < NEAR
    return near


def _around(amount: Float) -> tuple[Float, Float, Float]:
    """Places x, y from the middle of an amount (ny, nx); 1 to its right and left, -1 above and below, 0 between."""
    y, x = (np.arange(n, dtype=np.float64) for n in amount.shape)
    x, y = x[None] - (amount.sum(axis=0) @ x) / amount.sum(), y[:, None] - (amount.sum(axis=1) @ y) / amount.sum()
    return x, y, np.sign(np.abs(x) - np.abs(y))


KIND = Gallery(
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
