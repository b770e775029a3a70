"""What plugins of dye hand over, held against its layout."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from nuno.wrong import Wrong, check_array, check_number, check_type
from nuno_schemas.dye import Cells, DyeReport, DyeState, Isotherm, Supply


def check_cells(cells: Cells) -> None:
    """A cloth of cells."""
    check_type("cells", cells, Cells)
    shape = cells.fibre.shape if isinstance(cells.fibre, np.ndarray) else ()
    check_array("cells.fibre", cells.fibre, np.bool_, (2, None, None))
    check_array("cells.up", cells.up, np.bool_, shape)
    for name in ("porosity", "twist", "resist"):
        check_array(f"cells.{name}", getattr(cells, name), np.float64, shape, 0.0, 1.0)
    for name in ("size", "v_max"):
        check_number(f"cells.{name}", getattr(cells, name), above=0.0)
    for name, value in vars(cells.tortuosity).items():
        check_number(f"cells.tortuosity.{name}", value, 0.0)
    for i, rows in enumerate(cells.yarns or ()):
        check_array(f"cells.yarns[{i}]", rows, np.int32, (shape[1 + i],), 0)


def check_cloth(found: Any, dyes: int) -> None:
    """Cells and the amounts of so many dyes that they hold."""
    if len(found) != 2:
        raise Wrong(f"it is {len(found)} things, not cells and amounts")
    cells, state = found
    check_cells(cells)
    check_type("amounts", state, DyeState)
    check_amounts(state, (dyes, *cells.fibre.shape))


def check_amounts(state: DyeState, shape: tuple[int, ...]) -> None:
    """Amounts of dye (dyes, 2, ny, nx)."""
    for name in ("phi", "fixed"):
        check_array(name, getattr(state, name), np.float64, shape)


def check_supplies(found: Sequence[Supply], cells: Cells, dyes: int) -> None:
    """Supplies of so many dyes to these cells."""
    for i, supply in enumerate(found):
        check_type(f"[{i}]", supply, Supply)
        check_array(f"[{i}].cells", supply.cells, np.bool_, cells.fibre.shape)
        check_number(f"[{i}].amount", supply.amount, 0.0)
        check_number(f"[{i}].start", supply.start, 0.0)
        if not 0 <= supply.dye < dyes:
            raise Wrong(f"[{i}].dye is {supply.dye}, outside 0 to {dyes - 1}")


def check_resists(found: Sequence[Any], cells: Cells) -> None:
    """What resists take of the room of these cells."""
    for i, values in enumerate(found):
        check_array(f"[{i}]", values, np.float64, cells.fibre.shape[1:], 0.0, 1.0)


def check_isotherm(isotherm: Isotherm) -> None:
    """An isotherm's numbers, or its function."""
    for name in ("first", "second"):
        check_number(name, getattr(isotherm, name), 0.0)
    if isotherm.kind == "python" and not callable(isotherm.function):
        raise Wrong("function is none, of kind 'python'")


def check_dye_report(report: DyeReport, dyes: int) -> None:
    """What a solver says of a frame of so many dyes."""
    if report.status not in ("ok", "diverged", "unconverged"):
        raise Wrong(f"status is {report.status!r}, not ok, diverged or unconverged")
    check_number("steps", report.steps, 0)
    for name in ("mobile", "fixed"):
        if len(getattr(report, name)) != dyes:
            raise Wrong(f"{name} has {len(getattr(report, name))} numbers, of {dyes} dyes")


def _dyes(args: Sequence[Any]) -> int:
    return next(len(arg.phi) for arg in args if isinstance(arg, DyeState))


DYE_CHECKS: Mapping[tuple[str, str], tuple[type, Callable[[Any, Sequence[Any]], None]]] = {
    ("nuno.dye_cloths", "build"): (tuple, lambda found, args: check_cloth(found, args[3])),
    ("nuno.dye_cloths", "count"): (int, lambda found, args: check_number("it", found, 0)),
    ("nuno.dye_cloths", "resists"): (tuple, lambda found, args: check_resists(found, args[1])),
    ("nuno.dye_cloths", "supplies"): (tuple, lambda found, args: check_supplies(found, args[1], len(args[2]))),
    ("nuno.dye_solvers", "advance"): (DyeReport, lambda found, args: check_dye_report(found, _dyes(args))),
    ("nuno.isotherms", "prepare"): (Isotherm, lambda found, args: check_isotherm(found)),
}
"""See `nuno.handed`."""
