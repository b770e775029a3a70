"""Drafts from Weaving Information Files (WIF 1.1, Nielsen et al. 1997), as weaving programs write them.

A threading says on which shafts each warp end hangs. Which shafts move at a pick is said by a treadling and a
tie-up, or by a lift plan; where a file has all three the first two count. Sections may be sparse: an end or a pick
that is not listed takes its section's default, no shaft, no treadle.
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
"""Most lifts of single ends or shafts, over all picks: threading with several shafts an end multiplies the work."""


@dataclass(frozen=True)
class Loom:
    """How a loom is set up.

    threading  (ends, shafts) bool      on which shafts an end hangs
    pressed    (picks, treadles) bool   treadles that are pressed; without a tie-up (picks, shafts), those that move
    tie_up     (treadles, shafts) bool  which shafts a treadle moves; None of a lift plan
    """

    threading: Bool
    pressed: Bool
    tie_up: Bool | None

    @property
    def moved(self) -> Bool:
        """(picks, shafts) the shafts that move at each pick."""
        if self.tie_up is None:
            return self.pressed
        pick, treadle = np.nonzero(self.pressed)
        return _join(self.tie_up[treadle], pick, len(self.pressed))


@dataclass(frozen=True)
class Draft:
    """A weave with its yarns: drawdown (picks, ends) bool, True where the warp is above; lines left out, in words."""

    drawdown: Bool
    warp: Yarns
    weft: Yarns
    loom: Loom
    left_out: tuple[str, ...]


def read_wif(path: Path) -> Draft:
    """Raises BadInput, with line, section and key, for a file that does not say how to weave."""
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
    """Lines on yarns and treadles beyond those that there are, which nothing is woven with."""
    found = [(f"{name} {kind}", number, yarn) for name, number, yarn in (("WARP", ends, "end"), ("WEFT", picks, "pick"))
             for kind in ("COLORS", "SPACING", "THICKNESS")]  # fmt: skip
    found += [("TIEUP", len(loom.tie_up), "treadle")] if loom.tie_up is not None else []
    return tuple(
        f"[{name}] has lines of {what}s that there are not ({number} are stated): {listed(keys)}"
        for name, number, what in found if (keys := sections.get(name).beyond(number))
    )  # fmt: skip


def count_yarns(sections: Sections) -> tuple[int, int]:
    """Numbers of ends and picks. Raises BadInput for more than a drawdown can have, before anything is allocated."""
    ends, picks = (sections.need(name, "says how many yarns there are").need("THREADS") for name in ("WARP", "WEFT"))
    number = ends.whole(1, MOST_YARNS, "a number of yarns")
    most = min(MOST_YARNS, MOST_CROSSINGS // number)
    return number, picks.whole(1, most, f"a number of yarns across {number} ends")


def read_lifts(sections: Sections, picks: int, shafts: int) -> tuple[Bool, Bool | None]:
    """What is pressed at each pick, and the tie-up; see `Loom`."""
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
    """Treadles as the file states, or as many as are tied up if it does not. Raises BadInput for more than `most`."""
    stated = sections.get("WEAVING").get("TREADLES")
    number = stated.whole(0, MOST_YARNS, "a number of treadles") if stated else 0
    number = number or max((key for key, _ in sections.get("TIEUP").numbered(MOST_YARNS, "treadle")), default=0)
    if number > most:
        raise BadInput(
            "too many treadles for so many picks and shafts", file=sections.file, field="[WEAVING] TREADLES",
            value=number, limit=f"{most}",
        )  # fmt: skip
    return number


def _join(rows: Bool, place: NDArray[np.intp], number: int) -> Bool:
    """(number, m) rows (k, m) put together by `or` at places (k,), which do not fall."""
    out = np.zeros((number, rows.shape[1]), np.bool_)
    if len(place):
        starts = np.flatnonzero(np.diff(place, prepend=-1))
        out[place[starts]] = np.logical_or.reduceat(rows, starts, axis=0)
    return out


def weave(threading: Bool, lifts: Bool) -> Bool:
    """(picks, ends) True where an end's shafts, or one of them, are up."""
    end, shaft = np.nonzero(threading)
    return np.ascontiguousarray(_join(np.ascontiguousarray(lifts.T)[shaft], end, len(threading)).T)


def _read_table(section: Section, rows: int, columns: int, what: str, entry: str, sparse: bool = False) -> Bool:
    """(rows, columns) the numbers listed for each key; 0 is none.

    Raises BadInput for numbers beyond, and, where the table is not sparse, for keys beyond and where the last keys are
    missing: then the counts do not agree.
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
