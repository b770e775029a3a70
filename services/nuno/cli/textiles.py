"""Fabrics, yarns, dyes and drafts: the presets that scenes can name, a laboratory's sheet, a weaver's draft."""

from __future__ import annotations

import argparse
import textwrap
from collections.abc import Mapping, Sequence
from pathlib import Path

from nuno.cli.active_runs import align
from nuno.exports.dyed_pictures import caption
from nuno.output_files import check_target, write_png, writing
from nuno.plugin_contract import registry
from nuno.scene.templates import import_sheet, in_units
from nuno_schemas.dyeing import list_dyes
from nuno_schemas.errors import BadInput, nearest
from nuno_schemas.pictures import DrawnDraft
from nuno_schemas.preset import Imported, Preset

# `nuno weave`: what a weaver's draft holds, and the draft drawn in its colours and at its scale.


def weave_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("draft", type=Path, metavar="FILE", help="a Weaving Information File, .wif")
    parser.add_argument(
        "--png", type=Path, metavar="FILE", help="draw it: threading, tie-up, treadling and drawdown, with a scale"
    )


def weave_command(args: argparse.Namespace) -> int:
    if not args.draft.is_file():
        raise BadInput("no such file", value=str(args.draft), remedy="a WIF file that a weaving program has written")
    if args.png is not None:
        check_target(args.png, ".png")
    cloth = registry.offering("nuno.dye_cloths", "draw_draft", "draws drafts")
    drawn: DrawnDraft = cloth.draw_draft(args.draft)
    width = max(map(len, drawn.facts))
    print(f"{args.draft.name}\n" + "\n".join(f"  {name:{width}}  {text}" for name, text in drawn.facts.items()))
    if args.png is not None:
        words = f"{drawn.facts['ends']} ends x {drawn.facts['picks']} picks"
        words += f"   {drawn.facts['size']}" if drawn.pixel is not None else ""
        print(write_png(args.png, caption(drawn.picture, words, drawn.pixel)))
    return 0


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


# `nuno fabric import`: a fabric from a laboratory's sheet, as a scene takes it, and what virtual tests find of it.


def fabric_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("action", choices=["import"], help="read a laboratory's sheet")
    parser.add_argument(
        "sheet", type=Path, metavar="FILE",
        help="values of KES-F, FAST or a cantilever, .yaml or .csv: instrument, then each by the instrument's own "
        "name, one number or warp and weft, in its units; and a drape to hold nuno test against: drape coefficient and "
        "nodes, or a photograph of the shadow",
    )  # fmt: skip
    parser.add_argument("--like", metavar="PRESET", help="what the sheet does not tell is as of this fabric")
    parser.add_argument("--out", type=Path, metavar="FILE", help="write the fabric as YAML, for a scene")


def fabric_command(args: argparse.Namespace) -> int:
    fabric, head = import_sheet(args.sheet, args.like)
    text = as_yaml(fabric, head)
    print("\n".join([sheet_table(fabric), "", *origins(left_out(fabric))]))
    if fabric.unused:
        print(f"\nnot used, for no force here has it: {', '.join(fabric.unused)}")
    print(f"\n{text}", end="")
    if args.out is not None:
        with writing(args.out, args.out.suffix) as new:
            new.write_text(text, encoding="utf-8")
    return 0


def sheet_table(fabric: Imported) -> str:
    """Return a table of the measures, their origins, and the results of virtual tests."""
    rows = [["", "value", "", "virtual test", "off", "how"]]
    for name, value in {**fabric.fabric, **fabric.drape}.items():
        tested = fabric.measured.get(name)
        off = "" if tested is None else f"{100.0 * (tested / value - 1.0):+.2f} %"
        seen = "" if tested is None else f"{tested:.4g}"
        rows.append([name, f"{value:.4g}", fabric.units[name], seen, off, fabric.how[name]])
    return align(rows, left=(0, 2, 5))


def as_yaml(fabric: Imported, head: list[str]) -> str:
    """Return the `fabric` of a scene after comments, and its measured drape as `measured`."""
    lines = [*(f"# {line}" for line in head), "fabric:", *_entries(fabric, fabric.fabric)]
    lines += [f"  # {line}" for line in origins(left_out(fabric))]
    if fabric.drape:
        note = "of its drape, for nuno test to be held against; no part of the fabric"
        lines += [f"measured:  # {note}", *_entries(fabric, fabric.drape)]
    return "\n".join(lines) + "\n"


def left_out(fabric: Imported) -> dict[str, str]:
    """Return the origins of a fabric's values that are not in the sheet."""
    return {name: how for name, how in fabric.how.items() if name not in {*fabric.fabric, *fabric.drape}}


def _entries(fabric: Imported, values: Mapping[str, float]) -> list[str]:
    """Return values with their units and origins."""
    return [f"  {name}: {text}  # {fabric.how[name]}" for name, text in in_units(fabric, values).items()]
