"""Figures of the dye paper: their scenes, run and drawn, and held against what the paper says of them."""

from __future__ import annotations

import functools
import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.ndimage import uniform_filter

from nuno.dye.painter import DyePainter
from nuno.dye.run import DyeRun
from nuno.scene import scene_file, shipped
from nuno.scene.scene_file import Loaded
from nuno_bench.gallery.kind import Figure, Finding, Gallery, Measures, ShownScene
from nuno_bench.machine import cores
from nuno_bench.report.page import Table, number
from nuno_schemas.dye import Cells
from nuno_schemas.dyeing import DyeView
from nuno_schemas.fabric import Bool, Float
from nuno_schemas.pictures import Picture, amount_seen

NEAR = 2e-3
"""Around the middle of the dye [m]: what lies farther is too pale to be judged by eye."""
DROP = 1.5e-3
"""Diameter of the paper's drop [m]; dye within this radius of its middle has stayed near it."""
STAIN = 0.1
"""Share of the darkest crossing from which a crossing belongs to the stain."""
DYED = 0.05
"""Amount of dye from which cloth counts as dyed: a twentieth of what a cell can hold."""
SEEN = 0.25
"""Least contrast of crossings that the eye takes for a mottle under the texture of yarns: 3 parts of dye beside 5."""
SIDE = 480
"""Pixels of a picture, about."""
SEEN_FIXED = ("fig9a", "fig9b", "fig9c")
"""Scenes that the paper shows by what fibre has taken, too."""
MOMENTS = {"fig12": (0, 1, 2, 4, 8, 16, 24, 32)}
"""Frames that are shown of a scene; of others the last one is."""
FIXED = "fixed dye alone"
"""Label of a picture of fixed dye."""
WEAVES = {"fig10a-slow": "plain", "fig10b-slow": "twill", "fig10c-slow": "satin"}
"""Scenes in which each weave is to be told from the others by the dye alone."""
PHOTOGRAPH = "fig14-mid"
"""The scene with the yarns of the photograph."""
BALANCE, CONTRAST, MOTTLE, STREAKS = "worst balance over what was supplied", "contrast", "unevenness", "streaks"
KEPT = "share near the drop"
DYED_SHARE, FIXED_SHARE, RIM = "share of cloth dyed", "share of cloth fixed", "most dye at the rim"
RESISTED, FOLLOWS = "dye under the resist over that beside it", "follows the {}"


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
    balance, failed, grown = 0.0, "", dict[str, float]()
    while not run.finished and not failed:
        frame = run.advance()
        balance = max(balance, run.balance(frame.report))
        failed = "" if frame.report.status == "ok" else frame.report.message
        if frame.number in moments:
            label = "" if moments == (frames,) else f"after {run.time / 3600:g} h"
            pictures.append((label, _draw(painter, run)))
            if label:
                grown[f"{RESISTED} {label}"] = resisted(Dyed(cells, run.state.phi[0], run.state.fixed[0], 1))
    if name in SEEN_FIXED:
        pictures.append((FIXED, _draw(painter, run, "fixed")))
    dyed = Dyed(cells, run.state.phi[0], run.state.fixed[0], _pitch(loaded))
    measured = {BALANCE: balance} | {name: float(one(dyed)) for name, one in measures_of(name).items()}
    return ShownScene(name, loaded.scene.description, pictures, measured | grown, failed)


def _pitch(loaded: Loaded) -> int:
    """The pitch of the warp in larger cells; 1 where a cloth has no such number."""
    cloth = loaded.dyed.cloth.config.model_dump()
    yarn = cloth.get("warp", {})
    return (int(yarn.get("width", 1)) + int(yarn.get("gap", 0))) // int(cloth.get("coarser", 1))


def measures_of(name: str) -> Mapping[str, Callable[[Dyed], float]]:
    """What is measured of a scene, by name."""
    figure = name.removeprefix("fig").removesuffix("-text")
    if name in WEAVES:
        return {CONTRAST: contrast} | {
            FOLLOWS.format(f"{weave} weave"): functools.partial(follows, weave=undyed(scene))
            for scene, weave in WEAVES.items()
        }
    match figure:
        case "8a" | "8b":
            return {CONTRAST: contrast, KEPT: kept_near}
        case "8e" | "8f" | "8g":
            return {MOTTLE: mottle, STREAKS: streaks}
        case "9a" | "9b" | "9c":
            return {DYED_SHARE: dyed_share, FIXED_SHARE: fixed_share, RIM: rim}
        case "11b":
            return {RESISTED: resisted}
        case "14-left" | "14-mid":
            return {FOLLOWS.format("photograph"): functools.partial(follows_yarns, cloth=undyed(PHOTOGRAPH))}
        case _:
            return {CONTRAST: contrast} if figure[:2] in ("8c", "8d", "10") else {}


@functools.cache
def undyed(name: str) -> Cells:
    """The cells of a scene."""
    return DyeRun(scene_file.read(scenes()[name]), 1).cells


def _draw(painter: DyePainter, run: DyeRun, view: DyeView = "all") -> Picture:
    return np.asarray(painter.chosen.plugin.draw(painter.prepared, amount_seen(run.state.phi, run.state.fixed, view)))


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
        return np.asarray(np.where(self.cells.up[1], total[1], total[0]))


def contrast(dyed: Dyed) -> float:
    """Difference of the dye of weft and warp at a crossing, over their sum: root mean square over the stain.

    It is what a crossing changes by as the other yarn comes up, free of how the stain fades outwards.
    """
    weft, warp = (crossings(layer, dyed.pitch) for layer in dyed.phi + dyed.fixed)
    part = stain(crossings(dyed.shown, dyed.pitch))
    return float(np.sqrt(np.square((weft - warp)[part] / (weft + warp)[part]).mean()))


def stain(shown: Float) -> Bool:
    """Crossings of at least STAIN of the darkest, on a mean over 3 x 3."""
    smooth = _smooth(shown)
    return np.asarray(smooth >= STAIN * smooth.max())


def kept_near(dyed: Dyed) -> float:
    """Share of all dye within DROP of its middle."""
    amount = (dyed.phi + dyed.fixed).sum(axis=0)
    x, y, _ = _around(amount)
    return float(amount[np.hypot(x, y) * dyed.cells.size <= DROP].sum() / amount.sum())


def dyed_share(dyed: Dyed) -> float:
    """Share of the cloth that shows more than DYED."""
    return float((dyed.shown > DYED * dyed.cells.v_max).mean())


def fixed_share(dyed: Dyed) -> float:
    """The same of what fibre has fixed, of the part that shows fibre."""
    fibre = np.where(dyed.cells.up[1], dyed.cells.fibre[1], dyed.cells.fibre[0])
    return dyed_share(dyed._replace(phi=np.zeros_like(dyed.phi))) / float(fibre.mean())


def rim(dyed: Dyed) -> float:
    """The most dye that shows at the rim."""
    shown = dyed.shown
    return float(max(shown[0].max(), shown[-1].max(), shown[:, 0].max(), shown[:, -1].max()))


def resisted(dyed: Dyed) -> float:
    """Mean dye where resist takes over half of a cell, over that where it takes less than a tenth."""
    total, taken = (dyed.phi + dyed.fixed)[dyed.cells.fibre], dyed.cells.resist[dyed.cells.fibre]
    return float(total[taken > 0.5].mean() / total[taken < 0.1].mean())


def mottle(dyed: Dyed) -> float:
    """Deviation of the crossings that show from the mean of those around them, as a share of the mean amount."""
    shown = crossings(dyed.shown, dyed.pitch)
    near = _near(shown, dyed)
    return float((shown - _smooth(shown))[near].std() / shown[near].mean())


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
    """How well what shows follows a weave, -1 to 1: a correlation over the crossings of the stain.

    Dye runs along yarns. To the right and left of its middle, then, crossings whose weft is above are darker
    than those around them, and above and below the middle those whose warp is.
    """
    shown = crossings(dyed.shown, dyed.pitch)
    return _correlate(shown, crossings(weave.up[1].astype(np.float64), dyed.pitch), stain(shown), 1)


def follows_yarns(dyed: Dyed, cloth: Cells) -> float:
    """The same for the yarns of a photograph, cell by cell, against the mean over about two yarns."""
    shown = dyed.shown
    smooth = _smooth(shown, 6)
    return _correlate(shown, cloth.up[1].astype(np.float64), smooth >= STAIN * smooth.max(), 6)


def _correlate(shown: Float, warp: Float, part: Bool, reach: int) -> float:
    smooth = _smooth(shown, reach)
    _, _, sector = _around(shown)
    darker = (0.5 - warp) * sector
    part = part & (sector != 0.0)
    return float(np.corrcoef((shown / np.maximum(smooth, 1e-300))[part], (darker - _smooth(darker, reach))[part])[0, 1])


def crossings(values: Float, pitch: int) -> Float:
    """(ny / pitch, nx / pitch) means of values (ny, nx) over the crossings of yarns."""
    ny, nx = (n // pitch for n in values.shape)
    return np.asarray(values[: ny * pitch, : nx * pitch].reshape(ny, pitch, nx, pitch).mean(axis=(1, 3)))


def _smooth(values: Float, reach: int = 1) -> Float:
    """Means over neighbours up to `reach` away, 3 x 3 for 1."""
    return np.asarray(uniform_filter(values, 2 * reach + 1, mode="nearest"))


def _near(values: Float, dyed: Dyed) -> Bool:
    x, y, _ = _around(values)
    return np.asarray(np.hypot(x, y) * dyed.pitch * dyed.cells.size < NEAR)


def _around(amount: Float) -> tuple[Float, Float, Float]:
    """Places x, y from the middle of an amount (ny, nx); 1 to its right and left, -1 above and below, 0 between."""
    y, x = (np.arange(n, dtype=np.float64) for n in amount.shape)
    x, y = x[None] - (amount.sum(axis=0) @ x) / amount.sum(), y[:, None] - (amount.sum(axis=1) @ y) / amount.sum()
    return x, y, np.sign(np.abs(x) - np.abs(y))


def vary(
    name: str, overrides: Sequence[str] = (), at: Sequence[float] = (), apart: bool = False
) -> Iterator[tuple[float, Dyed]]:
    """Run a scene with overrides; yield hours and cloth `at` these hours, or at the end.

    `apart` leaves a gap between crossings, as if each were cut off from the next ones of its yarns.
    """
    loaded = scene_file.read(scenes()[name], overrides)
    run = DyeRun(loaded, cores())
    if apart:
        both = run.cells.fibre.all(axis=0)
        run.cells = replace(run.cells, fibre=np.stack([both, both]))
        run.system = replace(run.system, cells=run.cells)
        run.memory = run._prepare(run.supplies)
    while not run.finished:
        report = run.advance().report
        if report.status != "ok":
            return
        hours = run.time / 3600.0
        if run.finished or any(abs(hours - one) < 1e-6 for one in at):
            yield hours, Dyed(run.cells, run.state.phi[0], run.state.fixed[0], _pitch(loaded))


PRINTED = "as printed"
STEP = 1.8 / 3600.0
"""The paper's step [h]."""
READINGS: tuple[tuple[str, tuple[str, ...], tuple[float, ...], bool], ...] = (
    (f"{PRINTED} for 8 (d)", ("{I: 0.005, II: 0.005, III: 0.005, V: 1}",), (0.5, 1.0, 2.5), False),
    (f"{PRINTED} for 10", ("{I: 0.01, II: 0.01, III: 0.01, V: 1}",), (0.5, 1.0, 2.5), False),
    (f"{PRINTED} for 8 (d), but tau 3 V lowered", ("{I: 0.005, II: 0.005, III: 0.005, V: 0.005}",), (2.5,), False),
    (f"{PRINTED} for 10, but tau 3 V lowered", ("{I: 0.01, II: 0.01, III: 0.01, V: 0.1}",), (2.5,), False),
    ("tau 3 I lower", ("{I: 0.002, II: 0.005, III: 0.005, V: 1}",), (2.5,), False),
    ("tau 3 I lower, shipped for 8 (d)", ("{I: 0.001, II: 0.005, III: 0.005, V: 1}",), (2.5,), False),
    ("tau 3 I lower, shipped for 10", ("{I: 0.001, II: 0.01, III: 0.01, V: 1}",), (2.5,), False),
    ("tau 3 I, II, III lower", ("{I: 0.001, II: 0.001, III: 0.001, V: 1}",), (2.5,), False),
    ("tau 3 V high, other ways open", ("{I: 0.001, II: 1, III: 1, V: 1}",), (2.5,), False),
    ("tau 3 V lowered, other ways open", ("{I: 0.001, II: 1, III: 1, V: 0.1}",), (2.5,), False),
    ("tau 3 V lowered, other ways open", ("{I: 0.001, II: 1, III: 1, V: 0.01}",), (2.5,), False),
    ("tau 3 V lowered, layers as printed", ("{I: 0.005, II: 1, III: 1, V: 0.005}",), (2.5,), False),
    (f"{PRINTED} for 8 (d), a gap between crossings", ("{I: 0.005, II: 0.005, III: 0.005, V: 1}",), (2.5,), True),
    ("a gap between crossings, rims open", ("{I: 0.005, II: 0.005, III: 1, V: 1}",), (2.5,), True),
    (f"{PRINTED} for 8 (d), D falls with dye",
     ("{I: 0.005, II: 0.005, III: 0.005, V: 1}", "dye.dyes.0.weisz_zollinger={phi0: 0.02, cap: 1}"), (2.5,), False),
)  # fmt: skip
"""Readings of figures 8 (d) and 10: what tau 3 is, other fields, hours, and whether crossings are cut off."""


LONG = "dye.solver={plugin: rkl2, dt: 3 min}"


def sweep_mottle() -> Table:
    """Contrast of crossings and how well the dye follows its own weave, by reading."""
    rows = []
    for says, (tau3, *more), hours, apart in READINGS:
        found = [vary(name, [LONG, f"dye.cloth.tau3={tau3}", *more], hours, apart) for name in WEAVES]
        for hour in hours:
            steps, same = f"{hour / STEP:,.0f}", _next_of(found)
            if len(same) < len(found):
                rows.append([says, tau3, steps, "", "", "failed"])
                continue
            seen = [contrast(dyed) for dyed in same]
            fits = [_fits(dyed, own) for dyed, own in zip(same, WEAVES, strict=True)]
            holds = min(seen) >= SEEN and all(abs(own) > other for own, other in fits)
            texts = ", ".join(number(one) for one in seen), ", ".join(f"{own:.2f} ({other:.2f})" for own, other in fits)
            rows.append([says, tau3, steps, *texts, "yes" if holds else "no"])
    caption = (
        "Contrast of crossings, and the correlation of the dye with its own weave (in brackets the largest with "
        f"another), for plain weave, twill and satin; mottled: all contrasts are {SEEN:g} at least. It needs ways "
        "along and across the yarns that differ, whichever is the slow one, and layers that exchange little: at the "
        "printed tau 3 I they are level before 5,000 steps, with tau 3 V lowered, as the text says, too. Lowering it "
        "makes a mottle where the other ways are open; a negative correlation says that dye runs across the yarns."
    )
    headings = ("reading", "tau 3", "steps", "contrast", "follows its weave (another)", "mottled")
    return Table(headings, rows, caption, prose=True)


def _next_of(runs: Sequence[Iterator[tuple[float, Dyed]]]) -> list[Dyed]:
    """The next cloth of each run; fewer than runs where one has failed."""
    return [found[1] for found in [next(run, None) for run in runs] if found is not None]


def _fits(dyed: Dyed, own: str) -> tuple[float, float]:
    """The correlation with its own weave, and the largest with another."""
    found = {name: follows(dyed, undyed(name)) for name in WEAVES}
    return found[own], max(abs(fit) for name, fit in found.items() if name != own)


FACTOR = "dye.dyes.0.weisz_zollinger="
SOURCES: tuple[tuple[str, tuple[str, ...]], ...] = (
    ("phi0 0.01", (FACTOR + "{phi0: 0.01, cap: 1}",)),
    ("phi0 0.015", (FACTOR + "{phi0: 0.015, cap: 1}",)),
    ("phi0 0.02, shipped", ()),
    ("phi0 0.03", (FACTOR + "{phi0: 0.03, cap: 1}",)),
    ("phi0 0.05", (FACTOR + "{phi0: 0.05, cap: 1}",)),
    ("phi0 0.1", (FACTOR + "{phi0: 0.1, cap: 1}",)),
    ("phi0 0.02, uptake by the difference", ("dye.dyes.0.uptake=difference",)),
    ("D0 P T, without the factor", (FACTOR + "null",)),
    ("without the factor, drop not kept up", (FACTOR + "null", "dye.cloth.supply.0.maintained=false")),
    ("without the factor, square of 20 mm",
     (FACTOR + "null", "dye.cloth.cells=[400, 400]", "dye.cloth.supply.0.place=[10 mm, 10 mm]")),
)  # fmt: skip
"""Readings of what figure 9 leaves open."""
AT_HOURS = (5.0, 10.0, 25.0)


def sweep_isotherms() -> Table:
    """Share of the cloth dyed by Freundlich's and by Langmuir's isotherm, by reading, in larger cells."""
    rows = []
    for says, overrides in SOURCES:
        both = [
            vary(name, ["dye.cloth.coarser=2", "dye.solver.dt=15 min", *overrides], AT_HOURS)
            for name in ("fig9b", "fig9c")
        ]
        for hour in AT_HOURS:
            steps, same = f"{hour / STEP:,.0f}", _next_of(both)
            if len(same) < len(both):
                rows.append([says, steps, "", "", "", "", "failed"])
                continue
            wide, near = same
            b, c = dyed_share(wide), dyed_share(near)
            rows.append([says, steps, f"{b:.2f}", f"{c:.2f}", f"{rim(wide):.3f}", f"{rim(near):.3f}",
                         "yes" if _near_and_wide(b, c, rim(wide), rim(near)) else "no"])  # fmt: skip
    caption = (
        "phi0 / phi, 1 at most, is the factor of D in the paper's equation 4. As long as neither fills the square, the "
        "area dyed by Langmuir's is a half to four fifths of that by Freundlich's. Without the factor both fill it at "
        "50,000 steps, unless the drop is put only once or the square is larger. By the difference of mobile and fixed "
        "dye fibre never holds more than is mobile, and the two hardly differ."
    )
    headings = ("reading", "steps", "dyed, Freundlich", "dyed, Langmuir", "rim, Freundlich", "rim, Langmuir", "holds")
    return Table(headings, rows, caption, prose=True)


def _near_and_wide(wide: float, near: float, far_rim: float, near_rim: float) -> bool:
    return wide > 0.5 > near and near <= wide / 1.5 and near_rim < DYED < far_rim


def judge_even(m: Measures) -> Finding:
    seen = m["fig8a"][CONTRAST]
    return Finding(f"contrast {number(seen)}", seen < 0.01)


def judge_kept(m: Measures) -> Finding:
    kept, free = m["fig8b"][KEPT], m["fig8a"][KEPT]
    return Finding(f"{kept:.0%} of the dye is within 1.5 mm of the middle; in 8 (a) {free:.0%}", kept > 0.5 > free)


def judge_layers(m: Measures) -> Finding:
    seen = m["fig8c"][CONTRAST]
    return Finding(f"nothing to compare; contrast {number(seen)}", seen >= SEEN)


def judge_mottle(m: Measures) -> Finding:
    seen, printed = m["fig8d-slow"][CONTRAST], m["fig8d"][CONTRAST]
    return Finding(f"contrast {number(seen)}; with the printed tau 3 I {number(printed)}", seen >= SEEN)


def judge_uneven(scene: str) -> Callable[[Measures], Finding]:
    def judge(m: Measures) -> Finding:
        here, before = m[scene][MOTTLE], m["fig8e-text"][MOTTLE]
        return Finding(f"unevenness {number(here)}; of 8 (e) {number(before)}", here > 1.5 * before)

    return judge


def judge_streaks(m: Measures) -> Finding:
    narrow, broad, uneven = m["fig8g-text"][STREAKS], m["fig8f-text"][STREAKS], judge_uneven("fig8g-text")(m)
    return Finding(f"streaks {number(narrow)}, {uneven.value}; streaks of 8 (f) {number(broad)}",
                   narrow > 1.5 and uneven.holds)  # fmt: skip


def judge_isotherms(m: Measures) -> Finding:
    parts, holds = [], True
    for what in (DYED_SHARE, FIXED_SHARE):
        a, b, c = (m[name][what] for name in SEEN_FIXED)
        parts.append(f"{what}: (a) {a:.2f}, (b) {b:.2f}, (c) {c:.2f}")
        holds = holds and _near_and_wide(b, c, m["fig9b"][RIM], m["fig9c"][RIM])
    rims = f"{RIM}: (b) {number(m['fig9b'][RIM])}, (c) {number(m['fig9c'][RIM])}"
    return Finding("; ".join([*parts, rims]), holds)


def judge_weave(scene: str) -> Callable[[Measures], Finding]:
    def judge(m: Measures) -> Finding:
        fits = {weave: m[scene][FOLLOWS.format(f"{weave} weave")] for weave in WEAVES.values()}
        best, seen = max(fits, key=lambda weave: fits[weave]), m[scene][CONTRAST]
        text = ", ".join(f"{weave} {fit:.2f}" for weave, fit in fits.items())
        printed = m[scene.removesuffix("-slow")][CONTRAST]
        value = f"contrast {number(seen)} (with the printed tau 3 I {number(printed)}); follows {text}"
        return Finding(value, seen >= SEEN and best == WEAVES[scene])

    return judge


def judge_resist(m: Measures) -> Finding:
    share = m["fig11b"][RESISTED]
    return Finding(f"{share:.1%} of the dye beside it", share < 0.1)


def judge_waves(m: Measures) -> Finding:
    shares = [value for what, value in m["fig12"].items() if what.startswith(f"{RESISTED} after")]
    text = f"{', '.join(f'{one:.1%}' for one in shares)} of the dye beside them"
    return Finding(text, all(a > b for a, b in itertools.pairwise(shares)) and shares[-1] < 0.25)


def judge_runs(m: Measures) -> Finding:
    worst = max(one[BALANCE] for one in m.values())
    return Finding(f"nothing to compare; three run, dye is kept to {worst:.0e}", worst < 1e-10)


def judge_photograph(m: Measures) -> Finding:
    left, own = (m[name][FOLLOWS.format("photograph")] for name in ("fig14-left", PHOTOGRAPH))
    return Finding(f"follows the photograph's yarns {own:.2f}; left {left:.2f}", own > 0.4 and abs(left) < 0.5 * own)


KEPT_UP = "The drop is kept up, as the paper says of figures 9 and 11 (b) alone."
ROOM = (
    "The table varies the twist (e) and the porosity (f, g); the text says porosity and tortuosity, and the volume "
    f"ratio. The text's scenes are judged: B is r itself. {KEPT_UP}"
)
LAYERS = (
    "The layers exchange at tau 3 I = 0.001, which the paper does not print, in place of 0.005 in 8 (d) and 0.01 in "
    "10: as printed, they are level after 5,000 steps. By its text the mottle depends on a lower tau 3 V, where the "
    "table has 1, as here; its rows with tau 3 V lowered make no mottle."
)
MOTTLED = (
    "at tau 3 I = 0.001, which the paper does not print, contrast of the dye of weft and warp at the crossings of the "
    f"stain at least {SEEN:g}"
)
FIGURES = (
    Figure("8 (a)", "Cloth and dye hardly influence this result, which is there to compare the others with.",
           "contrast of weft and warp at the crossings, their difference over their sum, less than 0.01", ("fig8a",),
           judge_even),
    Figure("8 (b)", "Much dye stays near where it was put, since much is adsorbed.",
           "over half of all dye is within twice the drop's radius, where 8 (a) has less than half", ("fig8b", "fig8a"),
           judge_kept, reading="k = 1 of the isotherm is not printed."),
    Figure("8 (c)", "(No sentence: by its table no dye passes between layers, or along fibre.)",
           f"of the table alone, the layers differ: contrast at the crossings at least {SEEN:g}", ("fig8c",),
           judge_layers),
    Figure("8 (d)", "The mottle seen here needs two layers, and tau 3 V to be set.", MOTTLED, ("fig8d-slow", "fig8d"),
           judge_mottle, reading=LAYERS, sweep=sweep_mottle),
    Figure("8 (e)", "Porosity and tortuosity vary at random; this changes the look less than (f) and (g).",
           "crossings of 8 (f) are 1.5 times as uneven as these", ("fig8e-text", "fig8e", "fig8f-text"),
           judge_uneven("fig8f-text"), reading=ROOM),
    Figure("8 (f)", "The volume ratio varies at random, which influences the look more than (e).",
           "crossings are 1.5 times as uneven as those of 8 (e)", ("fig8f-text", "fig8f", "fig8e-text"),
           judge_uneven("fig8f-text"), reading=ROOM),
    Figure("8 (g)", "With the same settings narrower yarns show streaks.",
           "weft yarns differ 1.5 times as much from each other as along themselves, and crossings are 1.5 times as "
           "uneven as those of 8 (e)", ("fig8g-text", "fig8g", "fig8f-text", "fig8e-text"), judge_streaks,
           reading=f"The table repeats the width of (f); yarns are half as wide here. {ROOM}"),
    Figure("9", "By Freundlich (b) dye spreads and is adsorbed over a wide area. By Langmuir (c) it stays near where "
           "it was put, since much is adsorbed at low concentration.",
           f"cloth with more than {DYED:g} of what a cell holds, of all dye and of fixed dye: (b) over half of the "
           "square and at its rim, (c) less than half, at most two thirds of (b), and not at its rim", SEEN_FIXED,
           judge_isotherms, reading="Fibre takes D_ab phi until it holds V_d or A_d (uptake: amount), as the "
           "paper's sentence on one-way diffusion says. phi0 of equation 4 is not printed: 0.02; the factor phi0 / "
           "phi is 1 at most, since D0 is that of water. Constants of the isotherms are not printed: k 0.5; k 0.15, "
           "b 0.1; K 200. Within its edge Langmuir's cloth is the darkest, since its fibre is full.",
           sweep=sweep_isotherms),
    *(
        Figure(f"10 ({letter})", "With tau 3 V lowered, as in 8 (d), the mottle shows clearly. Another "
               f"weave looks clearly different: here {weave} weave.",
               f"{MOTTLED}, and the dye alone follows {weave} weave better than the other two",
               (scene, scene.removesuffix("-slow")), judge_weave(scene), reading=LAYERS)
        for letter, (scene, weave) in zip("abc", WEAVES.items(), strict=True)
    ),
    Figure("11 (b)", "Dye is given along vertical lines, and paste has the shape of a fan, which shows.",
           "less than a tenth of the dye beside it is under the fan", ("fig11b",), judge_resist,
           reading="Lines are kept up, as the paper says. Their places, the fan and the steps are not printed: 20,000. "
           "The paste's edge bleeds by 0.1 mm."),
    Figure("12", "The pattern of waves comes out as the steps go on, since B is given by an image.",
           "the waves hold a smaller share of the dye beside them in each picture than in the one before, and in the "
           "end less than a quarter", ("fig12",), judge_waves,
           reading="Lines are kept up, though the paper does not say so: at 1.0 V they hold too little to dye the "
           "cloth. Waves take 95 % of the room, and bleed by 0.1 mm."),
    Figure("13", "(No sentence: it shows various weaves and parameters, which the paper does not print.)",
           "the paper gives none; the scenes run, and keep their dye",
           ("fig13a", "fig13b", "fig13c"), judge_runs, reading="Weaves and parameters are ours."),
    Figure("14", "Left, yarns of simulation and photograph do not agree, and dye does not follow the yarns. Where they "
           "agree (middle), it looks more natural.",
           "the dye's correlation with the yarns that the photograph shows is over 0.4, and left less than half of it",
           ("fig14-left", "fig14-mid"), judge_photograph,
           reading="The photograph is ours. The drop is kept up, though the paper does not say so; its steps are not "
           "printed: 5,000."),
)  # fmt: skip

KIND = Gallery(
    title="Dyed cloth",
    lead="The figures of the dye paper, each from its row of the paper's table; where its text says otherwise, from "
    "the text too (-text); for the mottle with a slower exchange of layers, which the paper does not print (-slow).",
    scenes=scenes,
    run_scene=run_scene,
    measures="What the criteria are measured by, and how far mobile and fixed dye are from what was supplied, at "
    "worst, as a share of it.",
    section=lambda name: f"Figure {figure_of(name)}",
    apart=FIXED,
    figures=FIGURES,
)
