"""Which engines are asked for, and which of them are there."""

from __future__ import annotations

import sys
from collections.abc import Sequence

from nuno_bench import extras, options
from nuno_bench.peers.table import Kind


def groups(kinds: Sequence[Kind]) -> dict[str, list[Kind]]:
    """What a name of --only may stand for: an engine as a whole, or one way of its."""
    found: dict[str, list[Kind]] = {}
    for kind in kinds:
        if (engine := kind.name.partition("-")[0]) != kind.name:
            found.setdefault(engine, []).append(kind)
    return found | {kind.name: [kind] for kind in kinds}


def choose(kinds: Sequence[Kind], only: str | None) -> list[Kind]:
    """Kinds by their names, or by the engine's. Raises BadInput for any other name."""
    known, names = groups(kinds), options.names_of(only)
    options.require_known(names, known, "peer", "--only")
    chosen = [kind for name in names for kind in known[name]]
    return [kind for kind in kinds if not names or kind in chosen]


def leave_out(kinds: Sequence[Kind], only: str | None) -> list[str]:
    """Which are not installed and how they are, a sentence for each package, said before anything runs.

    Raises BadInput where the user asked for one by name.
    """
    lacking: dict[str, list[str]] = {}
    for kind in (kind for kind in kinds if kind.missing):
        lacking.setdefault(kind.package, []).append(kind.name)
        if only:
            extras.require(f"{only} needs", kind.package, "--only")
    told = [f"left out, {', '.join(names)}: {extras.missing(package)}" for package, names in lacking.items()]
    for text in told:
        print(text, file=sys.stderr)
    return told
