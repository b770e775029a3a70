"""`nuno fabrics`: the fabrics that scenes can name, their sources, and what virtual tests measure."""

from __future__ import annotations

import argparse
import textwrap

from nuno import registry
from nuno_schemas.errors import BadInput, nearest
from nuno_schemas.preset import Measure, Preset

GROUP = "nuno.models"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("names", nargs="*", metavar="FABRIC", help="only these (default: all)")


def main(args: argparse.Namespace) -> int:
    known = find_presets()
    for name in args.names:
        if name not in known:
            raise BadInput(f"no fabric {name!r}", remedy=nearest(name, known))
    chosen = [preset for name, preset in known.items() if not args.names or name in args.names]
    for line in table(chosen):
        print(line)
    print()
    print(textwrap.fill(LEGEND, 100))
    for preset in chosen:
        print(f"\n{preset.name}: {preset.source}")
    return 0


LEGEND = (
    "The first row of a fabric holds the values of its source, which springs and hinges follow at any resolution. "
    "Below, what virtual tensile, shear and bending tests measure on 5 cm x 5 cm: with the sides held they give the "
    "same; free sides narrow under tension. No source gives the damping ratio: it is ours. Any value can be replaced "
    "in a scene, for example fabric: {preset: denim, bend_warp: 80 uN*m}."
)


def find_presets() -> dict[str, Preset]:
    """By name, of every installed model that lists some."""
    models = (registry.load(GROUP, name) for name in sorted(registry.installed(GROUP)))
    return {preset.name: preset for model in models if hasattr(model, "presets") for preset in model.presets()}


def table(presets: list[Preset]) -> list[str]:
    """Lines: a head with units, then for each fabric its values and one line for each test."""
    if not presets:
        return []
    columns = presets[0].measures
    rows = [["", *(column.name for column in columns)], ["", *(f"[{column.unit or '1'}]" for column in columns)]]
    for preset in presets:
        tests = list(dict.fromkeys(test for measure in preset.measures for test in measure.measured))
        rows.append([preset.name, *(_given(measure) for measure in preset.measures)])
        rows += [[f"  {test}", *(_measured(measure, test) for measure in preset.measures)] for test in tests]
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    return ["  ".join([row[0].ljust(widths[0]), *map(str.rjust, row[1:], widths[1:])]).rstrip() for row in rows]


def _given(measure: Measure) -> str:
    return "" if measure.given is None else _digits(measure.given)


def _measured(measure: Measure, test: str) -> str:
    return _digits(measure.measured[test]) if test in measure.measured else ""


def _digits(value: float) -> str:
    """Four significant digits, never as a power of ten."""
    return f"{float(f'{value:.4g}'):.10f}".rstrip("0").rstrip(".")
