"""`nuno test FABRIC`: a fabric's sheet as a textile laboratory would fill it in, from virtual instruments."""

from __future__ import annotations

import argparse
import json
import math
import sys
import tempfile
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cache, partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import brentq

import nuno
from nuno.exports.cloth import as_url
from nuno.exports.pictures import export_picture
from nuno.plugin_contract import registry
from nuno.recording.reader import open_recording
from nuno.scene import yaml_lines
from nuno.scene.files import read_text
from nuno_bench import machine, options
from nuno_bench.fabric_tests import specimens
from nuno_bench.fabric_tests.specimens import DOT, mount
from nuno_bench.piles import G
from nuno_bench.report import page, plots
from nuno_bench.report.page import number
from nuno_bench.report.plots import Curve, Panel
from nuno_bench.sweep.executor import Executor, add_executor_arguments, open_executor
from nuno_cloth.fabrics.laboratory import read_drape
from nuno_schemas.colour import read_rgb
from nuno_schemas.errors import BadInput, RunFailed
from nuno_schemas.fabric import Float

# What a laboratory's sheet holds of a fabric, found on virtual specimens, beside what theory or a laboratory says.

DIRECTIONS = {"warp": 0.0, "weft": 0.5 * math.pi, "bias": 0.25 * math.pi}
"""Angle of the warp to the specimen's length [rad]."""
STRIP = 32
"""Edges along a cantilever's free length."""
SLOPE = math.radians(41.5)
"""Of a cantilever: how far it can be pushed over an edge before it bends down to this is its overhang."""
ENOUGH = 1e-4
"""Length is found to this share of it. Friction scatters the slope, that of limp cloth by 0.5 %."""
FIRST = 0.01
"""Share of the guess by which another length is tried at least."""
STILL = 1e-5
"""Largest way of a vertex in a frame at rest, as a share of the longest way so far."""
HELD = 4
"""Edges of the strip that the clamp holds."""
WIDE = 4
"""Edges across it. ASTM's strip is 2.5 cm wide; narrow ones spare time, and bend the same where no Poisson's ratio
makes them curl.
"""
NARROW, SLIM = 120, 2
"""Edges along and across a strip that tips over: a sixtieth as wide as long, for the closed form is of narrow ones."""
LONG, STIFF = 0.2, 2400.0
"""Its length [m], and stiffness [N/m] by its rigidity over the square of its width."""
EDGES, SEEDS, FOLDS = (0.02, 0.01, 0.007), (1, 2, 3, 4, 5), (4, 5, 6, 7)
"""Of drapes [m]; the seeds, and starts in so many folds, are tried at the second of the edges; in the second number of
folds at all edges, for one number of folds on several meshes tells what the mesh does.
"""


@dataclass(frozen=True)
class SheetRow:
    """A value found in a laboratory's unit, the standard it is by, and what is expected, NaN for nothing: by theory, or
    as it was `measured` of the cloth itself; `spread` the least and the greatest of several.
    """

    what: str
    standard: str
    value: float
    unit: str
    expected: float = math.nan
    spread: tuple[float, float] | None = None
    measured: bool = False

    @property
    def off(self) -> float:
        """Share by which it is off, NaN where nothing is expected."""
        return self.value / self.expected - 1.0 if self.expected else math.nan


class Start(NamedTuple):
    """Of a drape: edge [m] of the triangles, seed of what is random, and folds that it begins in, 0 for none."""

    edge: float
    seed: int
    folds: int = 0


@dataclass
class Sheet:
    """Rows, and what a page draws: the loops of bending by direction, the drapes by their starts. `measured` holds what
    a laboratory found of a drape, in the rows' units.
    """

    rows: list[SheetRow]
    loops: dict[str, specimens.Loop]
    drapes: dict[Start, specimens.Drape]
    measured: Mapping[str, float] = field(default_factory=dict)

    def radii(self) -> tuple[float, float]:
        """Return the radii of disc and support [m]: those of the measured drape, if any."""
        given = {"specimen": 200.0 * specimens.RADIUS, "support": 200.0 * specimens.SUPPORT} | dict(self.measured)
        return given["specimen"] / 200.0, given["support"] / 200.0


@dataclass(frozen=True)
class TestOptions:
    """quick: coarser and fewer specimens; executor: where drapes are computed; say: takes what is done, in words"""

    quick: bool
    executor: Executor
    say: Callable[[str], None]


def measures(fabric: object) -> Mapping[str, Any]:
    """Return a fabric's measures in SI units. Raises BadInput."""
    plugin = registry.load("nuno.models", "swatch")
    loaded = mount("cantilever", fabric).problem.loaded
    found: Mapping[str, Any] = plugin.measures(loaded.models[0].config)
    return found


def test(fabric: object, wanted: list[str], how: TestOptions, measured: Mapping[str, float]) -> Sheet:
    """All tests of these names, in their order, beside what was measured of a drape. Raises BadInput for what is no
    fabric, RunFailed where a test fails.
    """
    given, sheet = measures(fabric), Sheet([], {}, {}, measured)
    for i, name in enumerate(wanted, 1):
        how.say(f"test {i} of {len(wanted)}: {name}")
        TESTS[name](sheet, fabric, given, how)
    return sheet


def _weigh(sheet: Sheet, fabric: object, given: Mapping[str, Any], how: TestOptions) -> None:
    found = specimens.density(mount("cantilever", fabric))
    sheet.rows.append(SheetRow("weight", "ISO 3801", 1e3 * found, "g/m^2", 1e3 * given["density"]))


def _pull(sheet: Sheet, fabric: object, given: Mapping[str, Any], how: TestOptions) -> None:
    """At first: along the bias (C_w + C_f + 2 C_wf) / 4 + G, its shear (C_w + C_f - 2 C_wf) / 4."""
    warp, weft, shear = given["warp"], given["weft"], given["shear"]
    both = min(shear, math.sqrt(warp * weft))
    stiff = {"warp": warp, "weft": weft, "bias": 0.25 * (warp + weft + 2.0 * both) + shear}
    slide = {"warp": shear, "bias": 0.25 * (warp + weft - 2.0 * both)}
    for name, expected in stiff.items():
        found = specimens.stretch(fabric, DIRECTIONS[name])
        sheet.rows.append(SheetRow(f"tension, {name}", "KES-FB1, at first, width held", found, "N/m", expected))
    for name, expected in slide.items():
        found = specimens.shear(fabric, DIRECTIONS[name])
        sheet.rows.append(SheetRow(f"shear, {name}", "KES-FB1, at first", found, "N/m", expected))


def _bend(sheet: Sheet, fabric: object, given: Mapping[str, Any], how: TestOptions) -> None:
    warp, weft, twist = given["bend_warp"], given["bend_weft"], given["bend_twist"]
    both = given["bend_poisson"] * math.sqrt(warp * weft)
    rigid = {"warp": warp, "weft": weft, "bias": 0.25 * (warp + weft + 2.0 * both) + twist}
    h_warp, h_weft = given["hysteresis_warp"], given["hysteresis_weft"]
    lost = {"warp": h_warp, "weft": h_weft, "bias": 0.25 * (math.sqrt(h_warp) + math.sqrt(h_weft)) ** 2}
    for name, angle in DIRECTIONS.items():
        loop = sheet.loops[name] = specimens.bend(fabric, angle)
        by = "KES-FB2, width held"
        sheet.rows.append(SheetRow(f"rigidity B, {name}", by, 1e6 * loop.rigidity, "uN*m", 1e6 * rigid[name]))
        if lost[name]:
            left, taken = min(0.5 * lost[name] / rigid[name], specimens.MOST), 2.0 * lost[name] * specimens.MOST
            opens = 180.0 * (1.0 - left / specimens.MOST)
            sheet.rows.append(SheetRow(f"hysteresis 2HB, {name}", by, 1e3 * loop.hysteresis, "mN", 1e3 * lost[name]))
            sheet.rows.append(SheetRow(f"curvature left, {name}", by, loop.left, "1/m", left))
            sheet.rows.append(SheetRow(f"work of a cycle, {name}", by, loop.work, "J/m^2", taken))
            sheet.rows.append(
                SheetRow(f"recovery angle, {name}", "as ISO 2313, from the loop", loop.recovery, "deg", opens)
            )


def _hang(sheet: Sheet, fabric: object, given: Mapping[str, Any], how: TestOptions) -> None:
    """Peirce's length of cloth without friction: with it strips hang less."""
    free = 1.0 - given["bend_poisson"] ** 2
    strips = {"warp": free * given["bend_warp"], "weft": free * given["bend_weft"], "bias": given["bend_bias"]}
    for name, rigidity in strips.items():
        if rigidity == 0.0:
            continue
        length = (rigidity / (given["density"] * G)) ** (1.0 / 3.0)
        edges = STRIP // 2 if how.quick else STRIP
        found = bending_length(overhang(fabric, 2.0 * length, edges, DIRECTIONS[name]))
        sheet.rows.append(SheetRow(f"bending length, {name}", "ASTM D1388, 41.5 deg", 1e3 * found, "mm", 1e3 * length))


def _tip(sheet: Sheet, fabric: object, given: Mapping[str, Any], how: TestOptions) -> None:
    """Of the fabric as if it bent alike along warp and weft, and so stiff in its plane that this does not bend first:
    what the closed form is for.
    """
    poisson, rigidity = given["bend_poisson"], math.sqrt(given["bend_warp"] * given["bend_weft"])
    if rigidity == 0.0:
        return
    stiff = STIFF * rigidity / (LONG * SLIM / NARROW) ** 2
    alike = {name: given[name] for name in ("density", "damping_ratio", "bend_poisson")}
    alike |= {"bend_warp": rigidity, "bend_weft": rigidity, "warp": stiff, "weft": stiff, "shear": 0.1 * stiff}
    strip, expected = rigidity * (1.0 - poisson**2), specimens.critical(poisson)
    for layout in ("irregular",) if how.quick else ("aligned", "crossed", "irregular"):
        found = specimens.tips_over(alike, strip, given["density"], LONG, NARROW, SLIM, layout=layout)
        by = f"w L^3 / B, {layout} mesh"
        sheet.rows.append(SheetRow("lateral buckling, as if isotropic", by, found, "", expected))


def _drape(sheet: Sheet, fabric: object, given: Mapping[str, Any], how: TestOptions) -> None:
    """Theory has no number, a laboratory may; the spread is over edges with and without folds at the start, and at one
    of the edges over seeds and over starts in folds.
    """
    radius, support = sheet.radii()
    middle, edges = EDGES[1], EDGES[1:2] if how.quick else EDGES
    seeds, folds = (SEEDS[:2], ()) if how.quick else (SEEDS, FOLDS)
    at, over_edges = f"edges of {1e3 * middle:g} mm", f"edges of {_listed(1e3 * edge for edge in edges)} mm"
    over = {
        f"seeds {seeds[0]} to {seeds[-1]}, {at}": [Start(middle, seed) for seed in seeds],
        over_edges: [Start(edge, seeds[0]) for edge in edges],
        f"started in {_listed(folds)} folds, {at}": [Start(middle, seeds[0], number) for number in folds],
        f"started in {FOLDS[1]} folds, {over_edges}": [Start(edge, seeds[0], k) for edge in edges for k in folds[1:2]],
    }
    # Those that take longest are begun first.
    starts, found = sorted({start for each in over.values() for start in each}), dict[Start, specimens.Drape]()
    for start, one in how.executor.run(partial(_drape_from, fabric, radius, support), starts):
        if isinstance(one, BadInput | RunFailed):
            raise one
        found[start] = one
        how.say(f"drape {len(found)} of {len(starts)} is at rest")
    sheet.drapes = {start: found[start] for start in starts}
    by = f"ISO 9073-9, {200.0 * radius:g} cm on {200.0 * support:g} cm"
    for what, unit, read in (("drape coefficient", "%", lambda one: 100.0 * one.coefficient),
                             ("nodes", "", lambda one: float(one.nodes))):  # fmt: skip
        known = sheet.measured.get(what.replace(" ", "_"), math.nan)
        for where, each in over.items():
            if len(each) > 1:
                # Nodes that a start was given say nothing of those that were measured.
                beside = math.nan if what == "nodes" and each[0].folds else known
                values = [read(found[start]) for start in each]
                sheet.rows.append(_spread(f"{what}, {where}", by, values, unit, beside))
    energies = [one.energy for start, one in found.items() if start.edge == middle]
    above = [100.0 * (1.0 - energy / min(energies)) for energy in energies]
    sheet.rows.append(_spread(f"energy at rest over the least, all with {at}", by, above, "%"))


def _drape_from(fabric: object, radius: float, support: float, start: Start) -> specimens.Drape:
    return specimens.drape(fabric, *start, radius, support)


def _listed(values: Iterable[float]) -> str:
    return ", ".join(f"{value:g}" for value in values)


def _spread(what: str, standard: str, values: list[float], unit: str, known: float = math.nan) -> SheetRow:
    """Their mean, from the least to the greatest, and what is known of it by measurement."""
    spread = min(values), max(values)
    return SheetRow(what, standard, float(np.mean(values)), unit, known, spread, not math.isnan(known))


def hang(fabric: object, length: float, edges: int, angle: float = 0.0, **model: Any) -> tuple[Float, Float]:
    """(n, 3) a strip of so many edges along its free length [m] at its start and at rest [m]; `angle` of its warp."""
    edge = length / edges
    size = [length + HELD * edge, WIDE * edge]
    rig = mount("cantilever", fabric, size=size, hold=HELD * edge, edge=edge, angle=angle, **model)
    return rig.fabric.position, rig.rest(STILL)


def steepness(start: Float, x: Float) -> float:
    """Height over width of a strip at x (n, 3) [m], from its clamp to the middle of its end."""
    end = start[:, 0] > start[:, 0].max() - 1e-9
    return float(-x[end, 1].mean() / x[end, 0].mean())


def overhang(fabric: object, guess: float, edges: int, angle: float = 0.0, **model: Any) -> float:
    """Length [m] of the strip whose end is SLOPE below its clamp, looked for from a guess of it: the slope's tangent
    grows about with the third power of the length. It is found between a longer and a shorter one, so that slopes that
    friction scatters have one, too. Raises RunFailed where there is none.
    """

    @cache
    def off(log: float) -> float:
        return math.log(steepness(*hang(fabric, math.exp(log), edges, angle, **model)) / math.tan(SLOPE))

    start = math.log(guess)
    reach = math.copysign(max(abs(off(start)) / 2.0, FIRST), -off(start))
    for _ in range(4):
        if off(start) * off(start + reach) <= 0.0:
            return math.exp(brentq(off, start, start + reach, xtol=ENOUGH))
        reach *= 2.0
    raise RunFailed(f"cantilever: no length is found at which its end hangs {math.degrees(SLOPE):g} degrees below")


def bending_length(overhang: float) -> float:
    """Peirce's length [m] of a strip of this overhang: half of it, which is the elastica's to 1e-4."""
    return 0.5 * overhang


TESTS: Mapping[str, Callable[[Sheet, object, Mapping[str, Any], TestOptions], None]] = {
    "weight": _weigh, "tension": _pull, "bending": _bend, "cantilever": _hang, "buckling": _tip, "drape": _drape,
}  # fmt: skip


LEAD = (
    "What a laboratory would measure of this fabric, on virtual specimens: each standard's test as it is simulated, "
    "beside what the fabric's own measures say by the theory of plates and of the elastica, or what a laboratory "
    "measured of its drape. Nothing is tuned to a test."
)
HEADS = ("test", "standard", "found", "unit", "expected", "off", "least to greatest")
SIZE = (640, 400)


def test_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("fabric", metavar="FABRIC", help="a preset (nuno fabrics), a YAML file with a `fabric`, as "
                        "nuno fabric import writes one, with what was `measured` of its drape; or a fabric as a scene "
                        "has it")  # fmt: skip
    parser.add_argument("--only", metavar="A,B", help=f"of the tests {', '.join(TESTS)} (default: all)")
    parser.add_argument("--quick", action="store_true", help="coarser specimens, one mesh, two drapes")
    options.add_shared(parser, "--json", "--html", "--docs")
    parser.add_argument("--section", metavar="NAME", help="of the Markdown page (default: test)")
    add_executor_arguments(parser)


def test_command(args: argparse.Namespace) -> int:
    name, fabric, measured = find_fabric(args.fabric)
    wanted = options.names_of(args.only) or list(TESTS)
    options.require_known(wanted, TESTS, "test", "--only")
    section = args.section or "test"
    page.check_section(args.docs, section)
    if args.html is not None:
        plots.require_matplotlib()
    others, given = machine.OtherLoad(), measures(fabric)
    with open_executor(args) as where:
        how = TestOptions(args.quick, where, lambda text: print(text, file=sys.stderr, flush=True))
        found = test(fabric, wanted, how, measured)
    table = page.Table(HEADS, [cells(row) for row in found.rows], f"{name}: {given['source']}.")
    print(f"{table.caption}\n\n{table.text()}")
    parts = figures(found) if args.html is not None else []
    drawn = pictures(fabric, found) if args.html is not None and found.drapes else []
    sections: page.Sections = [("", [table]), ("Bending", parts), ("Drape", drawn)]
    data = {"fabric": dict(given), "measured": measured, "rows": found.rows}
    report = page.Report(f"{name}, tested", LEAD, sections, machine.about(others), data, [table])
    report.write(args.html, args.json, args.docs, section)
    return 0


def find_fabric(given: str) -> tuple[str, object, Mapping[str, float]]:
    """A name, the fabric as a scene has it, and what a file says was measured of its drape. Raises BadInput."""
    path = Path(given)
    if path.suffix.lower() in (".yaml", ".yml"):
        held, lines = yaml_lines.parse(read_text(path, "the fabric", "name a YAML file in UTF-8"), given)
        if not isinstance(held, Mapping) or "fabric" not in held:
            remedy = "nuno fabric import SHEET --out FILE writes one"
            raise BadInput("the file holds no `fabric`", given, field="fabric", remedy=remedy)
        return path.stem, held["fabric"], _find_drape(held.get("measured", {}), path, lines)
    value = yaml_lines.parse_value(given)
    if isinstance(value, Mapping):
        return f"{value.get('preset', 'a fabric')}, changed" if "preset" in value else "a fabric", dict(value), {}
    return given, given, {}


def _find_drape(given: object, path: Path, lines: Mapping[yaml_lines.Path, int]) -> Mapping[str, float]:
    if not isinstance(given, Mapping):
        remedy = "write for example measured: {drape_coefficient: 65 %, nodes: 7}"
        raise BadInput("what was measured are values by name", str(path), field="measured", value=given, remedy=remedy)
    try:
        return read_drape(given, path.parent)[0]
    except BadInput as error:
        line = lines.get(("measured", str(error.field)))
        raise replace(error, file=str(path), line=line, field=f"measured.{error.field}") from None


def cells(row: SheetRow) -> list[str]:
    expected, off = "", ""
    if not math.isnan(row.expected):
        expected = number(row.expected) + (", measured" if row.measured else "")
    if row.unit == "%" and expected:
        off = f"{row.value - row.expected:+.1f} points"
    elif not math.isnan(row.off):
        off = f"{100.0 * row.off:+.2f} %".replace("-0.00", "0.00").replace("+0.00", "0.00")
    spread = "" if row.spread is None else f"{number(row.spread[0])} to {number(row.spread[1])}"
    return [row.what, row.standard, number(row.value), row.unit, expected, off, spread]


def figures(found: Sheet) -> list[page.Part]:
    """The loops of moment over curvature."""
    curves = [
        Curve(name, 1e-2 * loop.curvature, 1e3 * loop.moment, i) for i, (name, loop) in enumerate(found.loops.items())
    ]
    if not curves:
        return []
    panel = Panel("moment per width [mN]", curves, "curvature [1/cm]")
    return [page.Figure(plots.draw([panel], 1), "Bent to 2.5 1/cm, back to -2.5 1/cm and again, as KES-FB2 does.")]


def pictures(fabric: object, found: Sheet) -> list[page.Part]:
    """The specimen on its support, and the shadows."""
    images = []
    with tempfile.TemporaryDirectory(prefix="nuno-") as folder:
        target = Path(folder) / "drape.mcap"
        radius, support = found.radii()
        model = {"fabric": json.dumps(fabric), "radius": radius, "hold": support}
        changes = [f"objects.0.model.{key}={value}" for key, value in model.items()]
        nuno.run("instruments/drapemeter", *changes, record=target)
        with open_recording(target) as recording:
            picture = read_rgb(export_picture(recording, Path(folder) / "drape.png", None, SIZE, "cloth"))
        images.append(page.Image(as_url(picture), f"On its support of {200.0 * support:g} cm, edges of 10 mm."))
    for start, one in found.drapes.items():
        dark = np.where(one.shadow[::2, ::2, None], np.uint8(60), np.uint8(245)).repeat(3, axis=2)
        begun = f", started in {start.folds} folds" if start.folds else ""
        says = f"Shadow with edges of {1e3 * start.edge:g} mm, seed {start.seed}{begun}: "
        says += f"{100.0 * one.coefficient:.1f} %, {one.nodes} nodes, {1e6 * one.energy:.0f} uJ."
        images.append(page.Image(as_url(dark), says))
    return [page.Pictures(images), f"A shadow's picture is {100.0 * DOT * len(one.shadow):.0f} cm wide."]
