"""The skirt paper's figures: a skirt on a dancer by each method, drawn, and held against what the paper says of it."""

from __future__ import annotations

import math
import statistics
import sys
import tempfile
from collections import Counter
from collections.abc import Callable
from functools import cache, partial
from pathlib import Path
from typing import NamedTuple

import nuno
from nuno.exports.cloth import read_frame
from nuno.exports.pictures import Painter
from nuno.recording.reader import open_recording
from nuno.scene import scene_file, shipped
from nuno_bench.gallery.kind import Figure, Finding, Gallery, Measures, ShownScene
from nuno_bench.integrators import (
    DEEPER,
    LEAVES,
    OFF,
    RUNAWAY,
    SPLIT,
    VIOLENT,
    WHOLE,
    Cell,
    Setting,
    map_settings,
    regions,
    setting_overrides,
)
from nuno_bench.report.page import number
from nuno_schemas.errors import RunFailed
from nuno_schemas.messages import PENETRATION
from nuno_schemas.pictures import Picture

SCENE = "skirt-paper"
SIZE = (480, 480)
AREA = "largest area of cloth in bodies [cm2]"


class Variant(NamedTuple):
    """Pictures of a figure: their label, the method and bones they are run by, the times that are drawn [s], and the
    setting of the map, None for the scene's own.
    """

    label: str
    method: str
    split: bool = True
    times: tuple[float, ...] = (1.5, 3.0, 6.0)
    setting: Setting | None = None


VARIANTS = (
    Variant("figure 5, one capsule a bone", "symplectic_euler", False),
    Variant("figure 6, FB Euler", "symplectic_euler"),
    Variant("figure 7, Euler", "euler", times=(1.5, 4.12, 5.5), setting=Setting(0.25, 2.0, 0.4, 2e-3)),
    Variant("figure 8, Runge-Kutta", "rk4"),
)
"""Euler is drawn where it survives and cloth leaves the body: a coarse, soft skirt in a medium that damps."""


@cache
def cells() -> tuple[Cell, ...]:
    """The map of the paper's experiment."""
    return tuple(map_settings(shipped.find(SCENE), [], partial(print, file=sys.stderr, flush=True)))


def run_scene(path: Path) -> ShownScene:
    """Run the paper's experiment by each of its methods, or to the first that fails. Raises BadInput."""
    description, pictures, area = scene_file.read(path).scene.description, list[tuple[str, Picture]](), 0.0
    for variant in VARIANTS:
        try:
            found, inside = draw_variant(path, variant)
        except RunFailed as error:
            why = str(error).partition("; recording kept in ")[0]
            return ShownScene(SCENE, description, pictures, failed=f"{variant.label}: {why}")
        pictures += found
        area = inside if variant.label.startswith("figure 6") else area
    return ShownScene(SCENE, description, pictures, {AREA: 1e4 * area})


def draw_variant(path: Path, variant: Variant) -> tuple[list[tuple[str, Picture]], float]:
    """Pictures over the dancer with bones in pieces, whichever the cloth met, and the largest area of cloth inside the
    bodies that it met [m^2].
    """
    own = ["allow_unstable=true"] if variant.setting is None else override_scene(path, variant.setting)
    with tempfile.TemporaryDirectory(prefix="nuno-") as folder:
        shape, target = Path(folder) / "shape.mcap", Path(folder) / "variant.mcap"
        bones = f"{SPLIT}={str(variant.split).lower()}"
        nuno.run(path, *own, f"solver.plugin={variant.method}", bones, record=target)
        if not variant.split:
            nuno.run(path, *own, record=shape)
        with open_recording(target if variant.split else shape) as drawn, open_recording(target) as run:
            rate = scene_file.read(path).scene.frame_rate
            frames = [read_frame(run, round(t * rate)) for t in variant.times]
            painter = Painter(drawn, [read_frame(drawn)], SIZE, colour="cloth")
            pictures = [(f"{variant.label}, {frame.t:.3g} s", painter.draw(frame)) for frame in frames]
            area = max(run.said(message).get("area") or 0.0 for message in run.messages([PENETRATION.name]))
    return pictures, area


def override_scene(path: Path, setting: Setting) -> list[str]:
    """Overrides that bring a scene to a setting of the map."""
    fabric = scene_file.read(path).models[0].config.model_dump()["fabric"]
    weaker = {name: [setting.stiffness * value for value in fabric[name]] for name in ("structural", "bending")}
    weaker |= {
        "shear": setting.stiffness * fabric["shear"],
        "damping": math.sqrt(setting.stiffness) * fabric["damping"],
    }
    return [
        *setting_overrides(path, [], setting),
        *(f"objects.0.model.fabric.{name}={value}" for name, value in weaker.items()),
    ]


def judge_bones(measured: Measures) -> Finding:
    """Figure 5: whole bones let cloth deeper into the body than bones in pieces do."""
    ratios = [cell.deeper(WHOLE) for cell in cells()]
    deeper = sum(ratio >= DEEPER for ratio in ratios)
    value = f"{statistics.median(ratios):.2f} times as deep in the median; deeper at {deeper} of {len(ratios)} settings"
    return Finding(value, 2 * deeper > len(ratios))


def judge_fb_euler(measured: Measures) -> Finding:
    """Figure 6: no part of the cloth is inside the body."""
    area = measured[SCENE][AREA]
    return Finding(f"{number(area)} cm^2 at most", area == 0.0)


def judge_euler(measured: Measures) -> Finding:
    """Figure 7: at some settings, also at that which is drawn, Euler survives, and cloth leaves the body."""
    found = Counter(cell.euler for cell in cells())
    drawn = next(cell.euler for cell in cells() if cell.setting == VARIANTS[2].setting)
    counts = "; ".join(f"{name}: {count}" for name, count in found.items())
    return Finding(f"{counts}; as drawn: {drawn}", drawn == OFF)


def judge_runge_kutta(measured: Measures) -> Finding:
    """Figure 8: steps take longer, and cloth sinks in deeper."""
    times, depths = ([cell.slower("rk4") for cell in cells()], [cell.deeper("rk4") for cell in cells()])
    time, deeper = statistics.median(times), sum(depth >= DEEPER for depth in depths)
    value = f"a step takes {time:.2f} times as long; deeper at {deeper} of {len(depths)} settings"
    return Finding(value, time > 1.0 and 2 * deeper > len(depths), NOT_RUNGE_KUTTA)


SWEEP = cache(lambda: regions(cells()))
"""Where each sentence of the paper holds."""
NOT_RUNGE_KUTTA = (
    "A vertex at rest sinks by m g / k under any method, and in an impact the depth is that of the same spring. "
    "By the formulas as they are printed, with damping frozen at the step's start, cloth sinks in deeper at some "
    "settings, as the table says: that may be what the paper saw."
)


def _figure(
    number: int, sentence: str, criterion: str, judge: Callable[[Measures], Finding], reading: str = ""
) -> Figure:
    """A figure of the paper: its pictures have its number, and the map is its sweep where it is judged by the map."""
    sweep = None if judge is judge_fb_euler else SWEEP
    return Figure(str(number), sentence, criterion, (SCENE,), judge, (f"figure {number},",), reading, sweep)


FIGURES = (
    _figure(
        5, "With one capsule for each bone, contact was not judged correctly.",
        f"By FB Euler, whole bones let cloth at least {DEEPER:g} times as deep into the body of bones in pieces as "
        "these do, at more than half of the settings; contact without a margin, as the paper's.", judge_bones,
        "Both are drawn over the body of bones in pieces, which is nearer to a person's shape.",
    ),
    _figure(
        6, "By FB Euler the skirt does not sink into the body where they meet.",
        "No cloth inside the body, by points on every triangle, in any frame of 6 s: 0 cm^2.", judge_fb_euler,
        "With contact's margin; the paper does not say what keeps its bodies from showing through.",
    ),
    _figure(
        7, "By Euler's method the cloth moves violently and leaves the body.",
        "At some settings, also at that which is drawn, Euler survives the 6 s (its energy grows by less than "
        f"{RUNAWAY:g} times what lifts the skirt by its size), its largest kinetic energy is {VIOLENT:g} times FB "
        f"Euler's, and at some moment cloth is {LEAVES:g} times as far from the body; contact without a margin, as "
        "the paper's.", judge_euler,
        "The paper prints no constants. Drawn at springs a quarter as stiff, a damping of 2 /s and 16 columns of 6 "
        "rows, where it survives.",
    ),
    _figure(
        8, "By Runge-Kutta the animation gets slow, and a leg sinks into the skirt where they meet.",
        f"A step takes longer than FB Euler's, and cloth is {DEEPER:g} times as deep in the body, at more than half of "
        "the settings; contact without a margin, as the paper's.", judge_runge_kutta,
    ),
)  # fmt: skip

KIND = Gallery(
    title="Skirt on a dancer",
    lead="The skirt paper's results: the same skirt on the same dancer by FB Euler (symplectic), Euler and Runge and "
    "Kutta's method. Its figures 1 to 4 are diagrams of springs, bones and capsules.",
    scenes=lambda: {SCENE: shipped.find(SCENE)},
    run_scene=run_scene,
    measures="By points on every triangle, of the run by FB Euler.",
    figures=FIGURES,
    alike=True,
)
