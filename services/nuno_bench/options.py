"""Options that several measurements have, and the checks of what is given for them."""

from __future__ import annotations

import argparse
import math
from collections.abc import Collection, Sequence
from pathlib import Path
from typing import Any

from nuno_schemas.errors import BadInput, nearest

SHARED: dict[str, dict[str, Any]] = {
    "scenes": {"nargs": "+", "metavar": "SCENE", "help": "a scene file, or the name of a shipped one"},
    "--set": {"action": "append", "default": [], "metavar": "KEY=VALUE", "dest": "overrides",
              "help": "change a field of the scene"},
    "--solvers": {"metavar": "A,B", "help": "solver plugins (default: all that are installed)"},
    "--resume": {"action": "store_true", "help": "go on with an interrupted sweep of the same arguments"},
    "--out": {"type": Path, "default": Path("recordings/bench"), "metavar": "DIR",
              "help": "where results go, and what is finished meanwhile (default: %(default)s)"},
    "--json": {"type": Path, "metavar": "FILE", "help": "write every figure as JSON"},
    "--html": {"type": Path, "metavar": "FILE", "help": "write a page"},
    "--rrd": {"type": Path, "metavar": "FILE", "help": "write the series as a rerun file, too"},
    "--docs": {"type": Path, "metavar": "FILE", "help": "put tables and pictures into this Markdown page's sections"},
}  # fmt: skip


def add_shared(parser: argparse.ArgumentParser, *names: str) -> None:
    """Options of these names, alike for all measurements."""
    for name in names:
        parser.add_argument(name, **SHARED[name])


def add_repeats(parser: argparse.ArgumentParser, default: int, what: str) -> None:
    parser.add_argument("--repeats", type=int, default=default, metavar="N", help=f"{what} (default: %(default)s)")


def add_seconds(parser: argparse.ArgumentParser, name: str, default: float, what: str) -> None:
    """An option that takes a wall time [s]."""
    text = f"{what} (default: %(default)g)"
    parser.add_argument(name, type=float, default=default, metavar="SECONDS", help=text)


def names_of(given: str | None) -> list[str]:
    """Names that are separated by commas."""
    return [name for name in (given or "").split(",") if name]


def require_known(names: Sequence[str], known: Collection[str], what: str, field: str) -> None:
    """Raises BadInput for a name that is not known, with the nearest that is."""
    for name in names:
        if name not in known:
            raise BadInput(f"no such {what}", field=field, value=name, remedy=nearest(name, known))


def require_repeats(repeats: int) -> None:
    """Raises BadInput for none."""
    if repeats < 1:
        raise BadInput("at least one repeat is needed", field="--repeats", value=repeats)


def require_budget(seconds: float) -> None:
    """Raises BadInput for a wall time [s] in which nothing can be done."""
    if not (seconds > 0.0 and math.isfinite(seconds)):
        raise BadInput("a sweep needs time", field="--budget", value=seconds, limit="more than 0 s")
