"""Drafts from Weaving Information Files (WIF 1.1, Nielsen et al. 1997), as weaving programs write them.

A threading gives the shafts of each warp end. The shafts that move at a pick follow from a treadling and a tie-up, or
from a lift plan; if a file has all three the first two count. Sections may be sparse: an end or a pick that is not
listed has its section's default, no shaft or no treadle.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from nuno_dye.drafts.text import Section, Sections, listed
from nuno_dye.drafts.weaves import MOST_CROSSINGS, MOST_YARNS, check_interlacing
from nuno_dye.drafts.yarns import Yarns, read_yarns
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Bool

MOST_LIFTS = 2**28
"""The most lifts of single ends or shafts, over all picks: several shafts per end multiply the work."""


@dataclass(frozen=True)
class Loom:
    """The set-up of a loom.

    threading  (ends, shafts) bool      shafts of each end
    pressed    (picks, treadles) bool   treadles that are pressed; without a tie-up (picks, shafts), those that move
    tie_up     (treadles, shafts) bool  shafts that each treadle moves; None for a lift plan
    """

    threading: Bool
    pressed: Bool
    tie_up: Bool | None

    @property
    def moved(self) -> Bool:
        """Shafts that move at each pick (picks, shafts)."""
        if self.tie_up is None:
            return self.pressed
        pick, treadle = np.nonzero(self.pressed)
        return _combine(self.tie_up[treadle], pick, len(self.pressed))


@dataclass(frozen=True)
class Draft:
    """A weave with its yarns: drawdown (picks, ends) bool, True where the warp is above; ignored lines, in words."""

    drawdown: Bool
    warp: Yarns
    weft: Yarns
    loom: Loom
    left_out: tuple[str, ...]


def read_wif(path: Path) -> Draft:
    """Read a draft. Raises BadInput, with line, section and key, for a file that does not define a weave."""
    sections = Sections(path)
    ends, picks = count_yarns(sections)
    weaving = sections.need("WEAVING", "says how many shafts there are")
    shafts = weaving.need("SHAFTS").whole(1, MOST_YARNS, "a number of shafts")
    if shafts * max(ends, picks) > MOST_CROSSINGS:
        weaving.need("SHAFTS").refuse("too many shafts for so many yarns", f"{MOST_CROSSINGS // max(ends, picks)}")
    rising = weaving.get("RISING SHED")
    pressed, tie_up = read_lifts(sections, picks, shafts)
    section = sections.need("THREADING", "says on which shafts each end hangs")
    loom = Loom(_read_table(section, ends, shafts, "end", "a shaft"), pressed, tie_up)
    lifts = loom.moved
    if rising is not None and not rising.truth():
        lifts = ~lifts
    _check_work(section, int(loom.threading.sum()) * picks)
    drawdown = weave(loom.threading, lifts)
    check_interlacing(drawdown, sections.file)
    warp, weft = read_yarns(sections, "WARP", ends), read_yarns(sections, "WEFT", picks)
    return Draft(drawdown, warp, weft, loom, find_left_out(sections, ends, picks, loom))


def find_left_out(sections: Sections, ends: int, picks: int, loom: Loom) -> tuple[str, ...]:
    """Describe lines on yarns and treadles beyond the stated numbers, which the weave does not use."""
    found = [(f"{name} {kind}", number, yarn) for name, number, yarn in (("WARP", ends, "end"), ("WEFT", picks, "pick"))
             for kind in ("COLORS", "SPACING", "THICKNESS")]  # fmt: skip
    found += [("TIEUP", len(loom.tie_up), "treadle")] if loom.tie_up is not None else []
    return tuple(
        f"[{name}] has lines of {what}s that there are not ({number} are stated): {listed(keys)}"
        for name, number, what in found if (keys := sections.get(name).beyond(number))
    )  # fmt: skip


def count_yarns(sections: Sections) -> tuple[int, int]:
    """Return the numbers of ends and picks. Raises BadInput for more than a drawdown can have, before allocation."""
    ends, picks = (sections.need(name, "says how many yarns there are").need("THREADS") for name in ("WARP", "WEFT"))
    number = ends.whole(1, MOST_YARNS, "a number of yarns")
    most = min(MOST_YARNS, MOST_CROSSINGS // number)
    return number, picks.whole(1, most, f"a number of yarns across {number} ends")


def read_lifts(sections: Sections, picks: int, shafts: int) -> tuple[Bool, Bool | None]:
    """Return `pressed` and `tie_up` of a Loom."""
    if not (sections.get("TREADLING").entries and sections.get("TIEUP").entries):
        why = "a lift plan, or a treadling and a tie-up, say which shafts move"
        if not sections.get("LIFTPLAN").entries:
            sections.need("TREADLING", why)
            sections.need("TIEUP", why)
        return _read_table(sections.get("LIFTPLAN"), picks, shafts, "pick", "a shaft"), None
    treadles = count_treadles(sections, MOST_CROSSINGS // max(shafts, picks))
    tied = _read_table(sections.get("TIEUP"), treadles, shafts, "treadle", "a shaft", sparse=True)
    pressed = _read_table(sections.get("TREADLING"), picks, treadles, "pick", "a treadle")
    _check_work(sections.get("TREADLING"), int(pressed.sum()) * shafts)
    return pressed, tied


def count_treadles(sections: Sections, most: int) -> int:
    """Return the stated number of treadles, or else that of tied ones. Raises BadInput for more than `most`."""
    stated = sections.get("WEAVING").get("TREADLES")
    number = stated.whole(0, MOST_YARNS, "a number of treadles") if stated else 0
    number = number or max((key for key, _ in sections.get("TIEUP").numbered(MOST_YARNS, "treadle")), default=0)
    if number > most:
        raise BadInput(
            "too many treadles for so many picks and shafts", file=sections.file, field="[WEAVING] TREADLES",
            value=number, limit=f"{most}",
        )  # fmt: skip
    return number


def _combine(rows: Bool, place: NDArray[np.intp], number: int) -> Bool:
    """Return rows (k, m) combined by `or` at ascending places (k,), as (number, m)."""
    out = np.zeros((number, rows.shape[1]), np.bool_)
    if len(place):
        starts = np.flatnonzero(np.diff(place, prepend=-1))
        out[place[starts]] = np.logical_or.reduceat(rows, starts, axis=0)
    return out


def weave(threading: Bool, lifts: Bool) -> Bool:
    """Return the drawdown (picks, ends), True where any of an end's shafts is up."""
    end, shaft = np.nonzero(threading)
    return np.ascontiguousarray(_combine(np.ascontiguousarray(lifts.T)[shaft], end, len(threading)).T)


def _read_table(section: Section, rows: int, columns: int, what: str, entry: str, sparse: bool = False) -> Bool:
    """Return a table (rows, columns) of the numbers listed for each key, where 0 is no number. Raises BadInput for
    numbers out of range, and, unless the table is sparse, for keys out of range and missing last keys, which contradict
    the stated count.
    """
    table = np.zeros((rows, columns + 1), np.bool_)
    last = 0
    for key, line in section.numbered(rows, what, beyond=sparse):
        table[key - 1, line.wholes(0, columns, entry)] = True
        last = max(last, key)
    if last < rows and not sparse:
        raise BadInput(
            "fewer lines than the file says there are", file=section.file, line=section.line,
            field=f"[{section.name}]", value=f"{last} {what}s", limit=f"{rows} {what}s",
            remedy=f"the missing lines, or Threads={last} in [{'WARP' if what == 'end' else 'WEFT'}]",
        )  # fmt: skip
    return np.ascontiguousarray(table[:, 1:])


def _check_work(section: Section, lifts: int) -> None:
    if lifts > MOST_LIFTS:
        raise BadInput(
            "lists too many at once", file=section.file, line=section.line, field=f"[{section.name}]", value=lifts,
            limit=f"{MOST_LIFTS} lifts",
        )  # fmt: skip
