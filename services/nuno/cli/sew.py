"""`nuno sew`: what is to be said of a sewing pattern before it is sewn."""

from __future__ import annotations

import argparse
import json
import sys
from dataclasses import asdict
from pathlib import Path

from nuno import registry
from nuno.cli.common import add_flags
from nuno.cli.top import align
from nuno.scene.files import SceneFiles
from nuno_schemas.errors import BadInput
from nuno_schemas.pattern import Checked, Remark


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "patterns", nargs="+", type=Path, metavar="PATTERN",
        help="a pattern as GarmentCode writes it: JSON, or YAML of the same fields",
    )  # fmt: skip
    parser.add_argument(
        "--check", action="store_true", required=True,
        help="say what is wrong with it and what looks wrong, and simulate nothing; exit code 2 if it cannot be sewn",
    )  # fmt: skip
    add_flags(
        parser, {"--gather": ("RATIO", "tell of seams whose edges differ by more than this (default: 1.1)", float)}
    )
    parser.set_defaults(gather=1.1)
    parser.add_argument("--json", action="store_true", help="the same for a program, as one JSON object a line")


def main(args: argparse.Namespace) -> int:
    if not args.gather >= 1.0:
        raise BadInput("no seam's longer edge is shorter", field="--gather", value=args.gather, limit="at least 1")
    model, code = registry.offering("nuno.models", "check_pattern", "reads sewing patterns"), 0
    for path in args.patterns:
        try:
            found: Checked = model.check_pattern(SceneFiles(path.parent), path.name, args.gather)
        except BadInput as error:
            print(f"error: {error}", file=sys.stderr)
            code = 2
            continue
        print(json.dumps({"file": str(path), **asdict(found)}) if args.json else describe(str(path), found))
        code = 2 if any(remark.wrong for remark in found.remarks) else code
    return code


def describe(file: str, found: Checked) -> str:
    """Panels, openings and remarks, for a person."""
    rows = [["panel", "edges", "sewn", "width cm", "height cm", "area cm²"]]
    for one in found.panels:
        measures = f"{1e2 * one.width:.1f}", f"{1e2 * one.height:.1f}", f"{1e4 * one.area:.0f}"
        rows.append([one.name, f"{one.edges}", f"{one.sewn}", *measures])
    whole = f"{_count(len(found.panels), 'panel')}, {_count(found.seams, 'seam')} of {found.length:.2f} m in all"
    lines = [f"{file}: {whole}", "", align(rows)]
    if found.openings:
        cells = [[f"{1e2 * one.length:.1f}", ", ".join(one.edges)] for one in found.openings]
        lines += ["", align([["opening cm", "edges round it"], *cells], left=(1,))]
    wrong = [remark for remark in found.remarks if remark.wrong]
    for title, remarks in (("wrong", wrong), ("remarks", [one for one in found.remarks if not one.wrong])):
        if remarks:
            lines += ["", *_told(title, remarks)]
    verdict = f"cannot be sewn: {_count(len(wrong), 'error')}" if wrong else "can be sewn"
    return "\n".join([*lines, "", f"{file}: {verdict}, {_count(len(found.remarks) - len(wrong), 'remark')}", ""])


def _told(title: str, remarks: list[Remark]) -> list[str]:
    rows = [[title, "line", "where", "what"]]
    for one in remarks:
        remedy = f" ({one.remedy})" if one.remedy else ""
        rows.append([one.kind, str(one.line or ""), one.where, one.text + remedy])
    return align(rows, left=(0, 2, 3)).split("\n")


def _count(number: int, noun: str) -> str:
    return f"{number} {noun}{'' if number == 1 else 's'}"
