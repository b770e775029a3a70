"""`nuno fabrics`, `nuno yarns` and `nuno dyes`: the presets that scenes can name, in units, with sources."""

from __future__ import annotations

import argparse
import textwrap
from collections.abc import Mapping, Sequence

from nuno.cli.top import align
from nuno.plugin_contract import registry
from nuno_schemas.dyeing import list_dyes
from nuno_schemas.errors import BadInput, nearest
from nuno_schemas.preset import Preset

GROUP = "nuno.models"
LISTS = {"fabrics": "presets", "yarns": "yarns"}
"""Method of a model that lists the presets of each command; dyes have no model."""
KINDS = ("measured", "derived", "assumed")
LEGENDS = {
    "fabrics": "The first row of a fabric holds its own values, which springs and hinges follow at any "
    "resolution. Below, what virtual tensile, shear and bending tests measure on 5 cm x 5 cm: with the sides held they "
    "give the same; free sides narrow under tension. No source gives the damping ratio: it is ours. Any value can be "
    "replaced in a scene, for example fabric: {preset: denim, bend_warp: 80 uN*m}.",
    "dyes": "M is the molar mass of what colours, D0 its diffusion coefficient in water, adsorption how fast fibre "
    "fixes it, k and K the constant of its isotherm. A scene names one by dyes: [indigo], or changes some of its "
    "fields: dyes: [{preset: indigo, adsorption: 0.02}].",
    "yarns": "EA is a yarn's tensile stiffness, force per strain; from the strain lock on it is EA_lock. Any value can "
    "be given in a scene, for example yarns: [nylon, {name: mine, ea: 2 N, density: 44 dtex}].",
}


def presets_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("names", nargs="*", metavar="NAME", help="only these (default: all)")


def presets_command(args: argparse.Namespace) -> int:
    print(show(choose(args.command, args.names)))
    print(f"\n{textwrap.fill(LEGENDS[args.command], 100)}")
    return 0


yarns_arguments = dyes_arguments = presets_arguments
yarns_command = dyes_command = presets_command


def choose(command: str, names: Sequence[str]) -> list[Preset]:
    """Return the presets of these names, in their own order, by default all. Raises BadInput for an unknown name."""
    presets_by_name = find_presets(command)
    for name in names:
        if name not in presets_by_name:
            raise BadInput(f"no {command.removesuffix('s')} {name!r}", remedy=nearest(name, presets_by_name))
    return [preset for name, preset in presets_by_name.items() if not names or name in names]


def find_presets(command: str) -> dict[str, Preset]:
    """Return the presets of all installed models by name; those of dyes are in the scene's schema."""
    if command == "dyes":
        return {preset.name: preset for preset in list_dyes()}
    models = (registry.load(GROUP, name) for name in sorted(registry.installed(GROUP)))
    lists = (getattr(model, LISTS[command], None) for model in models)
    return {preset.name: preset for each in lists if each is not None for preset in each()}


def show(presets: list[Preset]) -> str:
    """Return the values as a table, then the sources, and the origins of the values."""
    lines = [table(presets), ""]
    for one in presets:
        lines.append(textwrap.fill(f"{one.name}: {one.source}", 100, subsequent_indent="  "))
        lines += [f"  {line}" for line in origins(one.how)]
    return "\n".join(lines)


def origins(how: Mapping[str, str]) -> list[str]:
    """Return measured, derived and assumed values, a line for each reason."""
    lines = []
    for words in sorted(set(how.values()), key=lambda words: (KINDS.index(words.partition(":")[0]), words)):
        kind, _, reason = words.partition(": ")
        names = ", ".join(name for name, origin in how.items() if origin == words)
        lines.append(f"{kind}: {names}" + (f" ({reason})" if reason else ""))
    return lines


def table(presets: list[Preset]) -> str:
    """Return a head with units, then for each preset its values, and a line for each virtual test of it."""
    if not presets:
        return ""
    columns = presets[0].measures
    rows = [["", *(column.name for column in columns)], ["", *(f"[{column.unit or '1'}]" for column in columns)]]
    for preset in presets:
        tests = dict.fromkeys(test for measure in preset.measures for test in measure.measured)
        rows.append([preset.name, *(digits(measure.given) for measure in preset.measures)])
        rows += [[f"  {test}", *(digits(one.measured.get(test)) for one in preset.measures)] for test in tests]
    return align(rows)


def digits(value: float | None) -> str:
    """Format four significant digits, never as a power of ten; "" for None."""
    return "" if value is None else f"{float(f'{value:.4g}'):.10f}".rstrip("0").rstrip(".")
