"""`nuno sew`: patterns on a body, as a scene that is written and run; or a check of the patterns."""

from __future__ import annotations

import argparse
import json
import shlex
import sys
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
from pydantic import ValidationError

from nuno.cli.active_runs import align
from nuno.cli.common import add_flags
from nuno.formatting import many
from nuno.output_files import replacing
from nuno.plugin_contract import registry
from nuno.scene import scene_file
from nuno.scene.files import SceneFiles, near
from nuno.scene.templates import Garment, build_body, describe_worn, is_own, name_garments, unit_for
from nuno.scene.validation_errors import explain
from nuno_schemas.bodies import UNITS
from nuno_schemas.errors import BadInput
from nuno_schemas.pattern import Checked
from nuno_schemas.units import to_si

MANNEQUIN = Path("mannequin")
"""Name of the shipped body in `--body`, unless there is a file of that name."""

WEARING, CHECKING = ("fabric", "edge", "scene", "write"), ("gather", "json")
"""Options of a pattern on a body, and of a check of patterns."""
EDGE, GATHER = "2 cm", 1.1
"""Defaults of `--edge` and `--gather`."""


def sew_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "patterns", nargs="+", type=Path, metavar="PATTERN",
        help="a pattern as GarmentCode writes it: JSON, or YAML of the same fields; on a body the innermost first",
    )  # fmt: skip
    worn = parser.add_argument_group("put on a body")
    add_flags(worn, {
        "--body": ("FILE", "the body that wears them: OBJ, PLY, STL or GLB, upright, facing +z, in metres unless "
                   "its size says otherwise; or mannequin: the one that comes with nuno", Path),
        "--motion": ("FILE", "a BVH that the body moves by, with its skin (default: it stands)", Path),
        "--fabric": ("NAME...", "a preset (default: interlock; nuno fabrics lists them); again for each pattern", str),
        "--edge": ("LENGTH", f"of the triangles' sides (default: {EDGE})", str),
        "--scene": ("FILE", "the scene that is written and run (default: PATTERN...-worn.yaml, here)", Path),
    })  # fmt: skip
    worn.add_argument("--write", action="store_true", help="write the scene and build it, but do not run it")
    checked = parser.add_argument_group("or only look at the patterns")
    checked.add_argument(
        "--check", action="store_true",
        help="say what is wrong with it and what looks wrong, and simulate nothing; exit code 2 if it cannot be sewn",
    )  # fmt: skip
    add_flags(
        checked,
        {"--gather": ("RATIO", f"tell of seams whose edges differ by more than this (default: {GATHER})", float)},
    )
    checked.add_argument("--json", action="store_true", help="the same for a program, as one JSON object a line")


def sew_command(args: argparse.Namespace) -> int:
    if args.motion is not None and args.body is None:
        raise BadInput("a motion moves a body", field="--motion", value=str(args.motion), remedy="add --body FILE")
    if args.check == (args.body is not None):
        remedy = "nuno sew PATTERN --body body.obj, or nuno sew --check PATTERN..."
        raise BadInput("a pattern is put on a body, or checked", remedy=remedy)
    others, use = (CHECKING, "--check") if args.body is not None else (WEARING, "--body FILE")
    for name in others:
        if (value := getattr(args, name)) not in (None, [], False):
            remedy = f"leave it out, or take {use} instead"
            raise BadInput(f"for nuno sew {use} alone", field=f"--{name}", value=value, remedy=remedy)
    args.edge, args.gather = args.edge or EDGE, GATHER if args.gather is None else args.gather
    return check(args) if args.check else wear(args)


def wear(args: argparse.Namespace) -> int:
    """Write a scene in which a body wears the patterns, run it, and print the fit on a body that stands."""
    from nuno.cli import main as nuno

    fabrics = args.fabric or ["interlock"]
    if len(fabrics) not in (1, len(args.patterns)):
        raise BadInput("fabrics and patterns do not go together", field="--fabric", value=f"{len(fabrics)} fabrics",
                       limit=f"one, or {len(args.patterns)}, one for each pattern")  # fmt: skip
    _check_fabrics(fabrics)
    uses_mannequin = args.body == MANNEQUIN and not MANNEQUIN.exists()
    other_files = ({} if uses_mannequin else {"body": args.body}) | ({"motion": args.motion} if args.motion else {})
    files = [("pattern", pattern) for pattern in args.patterns] + list(other_files.items())
    for role, file in files:
        if not file.is_file():
            remedy = near(file) + ("mannequin is the one that comes with nuno" if role == "body" else "check the name")
            raise BadInput("no such file", field=role, value=str(file), remedy=remedy)
    _check_edge(args.edge)
    scene = args.scene or Path("-".join(pattern.stem for pattern in args.patterns) + "-worn.yaml")
    names = name_garments([pattern.stem for pattern in args.patterns])
    before = scene.read_text(encoding="utf-8") if scene.exists() else None
    if before is not None and not is_own(before, name_garments([scene.stem])[0]):
        remedy = f"nuno run {scene} takes it as it is; --scene FILE writes another"
        raise BadInput("the scene is there already, and has been changed", value=str(scene), remedy=remedy)
    for pattern in args.patterns:
        _remind(pattern)
    flags = _find_flags(args.body, args.patterns) if "body" in other_files else ("", False)
    roots = [root for root in dict.fromkeys(file.resolve().parent for _, file in files)
             if not root.is_relative_to(scene.resolve().parent)]  # fmt: skip
    known = SceneFiles(scene.parent, tuple(roots))
    each = zip(names, args.patterns, fabrics * (len(names) // len(fabrics)), strict=True)
    garments = [Garment(name, _name_in(known, pattern), fabric) for name, pattern, fabric in each]
    moved = {role: _name_in(known, file) for role, file in other_files.items()}
    with replacing(scene) as new:
        text = describe_worn(scene.stem, garments, args.edge, moved.get("body"), moved.get("motion"), flags)
        new.write_text(text, encoding="utf-8")
    if before not in (None, text):
        print(f"replaced   {scene}, which was written for other files or options", flush=True)
    command = ["run", str(scene), *(word for root in roots for word in ("--root", str(root)))]
    print(f"scene      {scene}  (change it, and: nuno {shlex.join(command)})", flush=True)
    if args.write:
        from nuno.simulation.cloth import build_fabrics

        build_fabrics(scene_file.read(scene, (), roots))  # raises the errors of a run
        return 0
    code = nuno(command)
    # A walking body does not have its measured height at the end.
    return code or (nuno(["fit", "last"]) if args.motion is None else 0)


def _name_in(files: SceneFiles, path: Path) -> str:
    """Return the name of a file for a scene: its path below the scene's folder, else its name, or its absolute path if
    another file of that name would be found first.
    """
    place, folder = path.resolve(), files.folder.resolve()
    name = place.relative_to(folder).as_posix() if place.is_relative_to(folder) else place.name
    return name if files.resolve(name) == place else str(place)


def _check_fabrics(fabrics: list[str]) -> None:
    """Before a scene is written. Raises BadInput."""
    model = registry.offering("nuno.models", "check_pattern", "reads sewing patterns")
    for fabric in fabrics:
        data = {"file": "pattern", "fabric": fabric}
        try:
            model.Config.model_validate(data)
        except ValidationError as error:
            explained = explain(error, data, (), "sew", {}, model.Config)
            raise replace(explained, file=None, field="--fabric") from None


def _check_edge(edge: str) -> None:
    """Before a scene is written. Raises BadInput."""
    model = registry.offering("nuno.models", "check_pattern", "reads sewing patterns")
    limits = model.Config.model_json_schema()["properties"]["edge"]["anyOf"][0]
    try:
        fits = limits["minimum"] <= to_si(edge, "m") <= limits["maximum"]
    except ValueError as error:
        raise BadInput(str(error), field="--edge", value=edge, remedy="for example '2 cm'") from None
    if not fits:
        limit = f"{1e3 * limits['minimum']:g} mm to {1e2 * limits['maximum']:g} cm"
        remedy = "with its unit, for example '2 cm': a bare number is in metres"
        raise BadInput("no length for sides of triangles", field="--edge", value=edge, limit=limit, remedy=remedy)


def _find_flags(body: Path, patterns: list[Path]) -> tuple[str, bool]:
    """Return and print the unit of a body's file, empty for the metre, and whether it must be mended; ("", False) for a
    file that the run refuses. Raises BadInput for a body that cannot wear the patterns in any unit.
    """
    shape, fault = build_body(body)
    if shape is None:
        return "", False
    size = float(np.ptp(shape.vertices, axis=0).max())
    unit = unit_for(size, patterns)
    if fault:
        scaled = build_body(body, unit)[0] or shape  # its notes name places in metres
        print(f"mend       {body}: {'; '.join([fault.problem, *scaled.notes])}", flush=True)
    if unit != "1m":
        text = f"taken as {unit}, {size * UNITS[unit]:.3g} m long: in metres it would be {size:.3g} m"
        print(f"unit       {body}: {text}", flush=True)
    return unit if unit != "1m" else "", fault is not None


def _remind(pattern: Path) -> None:
    """Print the kinds of remarks of a pattern's check, except gathers; the run reports errors. Raises BadInput for a
    file that is no pattern, and for a pattern of a size that no garment has.
    """
    model = registry.offering("nuno.models", "check_pattern", "reads sewing patterns")
    checked: Checked = model.check_pattern(SceneFiles(pattern.parent), pattern.name, np.inf)
    for one in checked.remarks:
        if one.kind == "size":
            raise BadInput(one.text, str(pattern), one.line, one.field, remedy=one.remedy)
    if kinds := list(dict.fromkeys(remark.kind for remark in checked.remarks if not remark.wrong)):
        print(f"remarks    {pattern}: {', '.join(kinds)}  (nuno sew --check {shlex.quote(str(pattern))})", flush=True)


def check(args: argparse.Namespace) -> int:
    """Print the remarks on each pattern; return the exit code."""
    if not args.gather >= 1.0:
        raise BadInput("no seam's longer edge is shorter", field="--gather", value=args.gather, limit="at least 1")
    model, code = registry.offering("nuno.models", "check_pattern", "reads sewing patterns"), 0
    for path in args.patterns:
        try:
            checked: Checked = model.check_pattern(SceneFiles(path.parent), path.name, args.gather)
        except BadInput as error:
            print(f"error: {error}", file=sys.stderr)
            code = 2
            continue
        print(json.dumps({"file": str(path), **asdict(checked)}) if args.json else describe(str(path), checked))
        code = 2 if any(remark.wrong for remark in checked.remarks) else code
    return code


def describe(file: str, pattern: Checked) -> str:
    """Return panels, openings and remarks as tables."""
    rows = [["panel", "edges", "sewn", "width cm", "height cm", "area cm²"]]
    for each in pattern.panels:
        measures = f"{1e2 * each.width:.1f}", f"{1e2 * each.height:.1f}", f"{1e4 * each.area:.0f}"
        rows.append([each.name, f"{each.edges}", f"{each.sewn}", *measures])
    whole = f"{many(len(pattern.panels), 'panel')}, {many(pattern.seams, 'seam')} of {pattern.length:.2f} m in all"
    lines = [f"{file}: {whole}", "", align(rows)]
    if pattern.openings:
        cells = [[f"{1e2 * each.length:.1f}", ", ".join(each.edges)] for each in pattern.openings]
        lines += ["", align([["opening cm", "edges round it"], *cells], left=(1,))]
    wrong = [remark for remark in pattern.remarks if remark.wrong]
    for title, remarks in (("wrong", wrong), ("remarks", [each for each in pattern.remarks if not each.wrong])):
        cells = [[one.kind, str(one.line or ""), one.where, one.text + (f" ({one.remedy})" if one.remedy else "")]
                 for one in remarks]  # fmt: skip
        if remarks:
            lines += ["", align([[title, "line", "where", "what"], *cells], left=(0, 2, 3))]
    verdict = f"cannot be sewn: {many(len(wrong), 'error')}" if wrong else "can be sewn"
    return "\n".join([*lines, "", f"{file}: {verdict}, {many(len(pattern.remarks) - len(wrong), 'remark')}", ""])
