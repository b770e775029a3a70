"""Drafts from Weaving Information Files (WIF 1.1, Nielsen et al. 1997): their text, yarns, and drawdown."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NoReturn

import numpy as np
from numpy.typing import NDArray

from nuno_dye.weaving_drafts.weaves import MOST_CROSSINGS, MOST_YARNS, check_interlacing
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Bool, Float

# The text of a Weaving Information File: sections of key=value lines, and their values.
#
# Names are case-insensitive, `;` starts a comment, except in text. The last of duplicate keys counts.

LARGEST_FILE = 16 * 2**20

_HEADER = re.compile(r"\s*\[([^\]]*)\]")
_WHOLE = re.compile(r"[0-9]{1,9}")
_REAL = re.compile(r"[0-9]{0,12}[.,]?[0-9]{0,20}(?:[eE][+-]?[0-9]{1,3})?")
_TRUE, _FALSE = {"true", "on", "yes", "1"}, {"false", "off", "no", "0"}


@dataclass(frozen=True)
class Entry:
    """One line key=value, and its place."""

    file: str
    line: int
    section: str
    key: str
    text: str

    def refuse(self, problem: str, limit: str, remedy: str | None = None) -> NoReturn:
        """Raise BadInput with file, line, section, key and value."""
        raise BadInput(
            problem, file=self.file, line=self.line, field=f"[{self.section}] {self.key}", value=self.text,
            limit=limit, remedy=remedy,
        )  # fmt: skip

    @property
    def bare(self) -> str:
        """The value without a comment."""
        return self.text.split(";", 1)[0].strip()

    def whole(self, low: int, high: int, what: str) -> int:
        """Return a whole number. Raises BadInput for anything else and beyond the limits."""
        return self._whole(self.bare, low, high, what)

    def wholes(self, low: int, high: int, what: str) -> list[int]:
        """Return whole numbers between commas, [] for an empty value. Raises BadInput likewise."""
        return [self._whole(part.strip(), low, high, what) for part in self.bare.split(",") if part.strip()]

    def _whole(self, text: str, low: int, high: int, what: str) -> int:
        if not _WHOLE.fullmatch(text) or not low <= int(text) <= high:
            self.refuse(f"not {what}", f"whole number from {low} to {high}")
        return int(text)

    def real(self, what: str) -> float:
        """Return a number not below 0; some programs write a decimal comma. Raises BadInput for anything else."""
        text = self.bare
        if not _REAL.fullmatch(text) or not any(map(str.isdigit, text)) or text[0] in "eE":
            self.refuse(f"not {what}", "a number not below 0")
        value = float(text.replace(",", "."))
        if not math.isfinite(value):
            self.refuse(f"not {what}", "a finite number")
        return value

    def truth(self) -> bool:
        """Return true or false. Raises BadInput for any other value."""
        text = self.bare.lower()
        if text not in _TRUE | _FALSE:
            self.refuse("neither true nor false", "true, on, yes, 1, false, off, no or 0")
        return text in _TRUE


@dataclass
class Section:
    """A section's entries by key, in upper case."""

    file: str
    name: str
    line: int | None = None
    entries: dict[str, Entry] = field(default_factory=dict)

    def get(self, key: str) -> Entry | None:
        """Return the entry of a key, None if it is missing or empty."""
        entry = self.entries.get(key)
        return entry if entry is not None and entry.bare else None

    def need(self, key: str) -> Entry:
        """Return the entry of a key. Raises BadInput if it is missing or empty."""
        entry = self.get(key)
        if entry is None:
            raise BadInput(
                "missing", file=self.file, line=self.line, field=f"[{self.name}] {key.title()}",
                remedy=f"a line {key.title()}=... in [{self.name}]",
            )  # fmt: skip
        return entry

    def beyond(self, most: int) -> list[int]:
        """Return keys that are numbers above `most`."""
        return sorted(int(key) for key in self.entries if _WHOLE.fullmatch(key) and int(key) > most)

    def numbered(self, most: int, what: str, beyond: bool = False) -> Iterator[tuple[int, Entry]]:
        """Yield entries with keys from 1 to `most`. Raises BadInput for any other key, unless numbers `beyond` may be
        skipped.
        """
        for entry in self.entries.values():
            if beyond and _WHOLE.fullmatch(entry.key) and int(entry.key) > most:
                continue
            if not _WHOLE.fullmatch(entry.key) or not 1 <= int(entry.key) <= most:
                entry.refuse(f"no such {what}", f"keys from 1 to {most}, the number of {what}s that the file states")
            yield int(entry.key), entry


class Sections:
    """All sections of a file."""

    def __init__(self, path: Path) -> None:
        """Read a file. Raises BadInput if it is empty, too large, or has no section [WIF]."""
        self.file = str(path)
        size = path.stat().st_size
        if not 0 < size <= LARGEST_FILE:
            raise BadInput(
                "empty or too large for a WIF", file=self.file, value=size, limit=f"1 to {LARGEST_FILE} bytes"
            )
        self.sections: dict[str, Section] = {}
        self._parse(decode(path.read_bytes()))
        if "WIF" not in self.sections:
            raise BadInput("no section [WIF]: not a Weaving Information File", file=self.file)

    def _parse(self, text: str) -> None:
        section: Section | None = None
        for number, line in enumerate(re.split(r"\r\n|\r|\n", text), 1):
            header = _HEADER.match(line)
            if header:
                name = _normalise(header[1])
                section = self.sections.setdefault(name, Section(self.file, name, number))
            elif section is not None and "=" in line and not line.lstrip().startswith(";"):
                key, value = line.split("=", 1)
                key = _normalise(key)
                section.entries[key] = Entry(self.file, number, section.name, key, value.strip())

    def get(self, name: str) -> Section:
        """Return a section, without entries if the file has no section of that name."""
        return self.sections.get(name) or Section(self.file, name)

    def need(self, name: str, why: str) -> Section:
        """Return a section. Raises BadInput if it is missing or empty."""
        section = self.get(name)
        if not section.entries:
            raise BadInput(
                f"the section is {'missing' if section.line is None else 'empty'}", file=self.file, line=section.line,
                field=f"[{name}]", limit=why,
            )  # fmt: skip
        return section


def listed(numbers: Sequence[int]) -> str:
    """Return the first few numbers as text."""
    return ", ".join(map(str, numbers[:8])) + (", ..." if len(numbers) > 8 else "")


def _normalise(name: str) -> str:
    return " ".join(name.upper().split())


def decode(data: bytes) -> str:
    """Decode UTF-8, UTF-16 with its mark, or else Latin-1, which accepts any byte."""
    for mark in (b"\xff\xfe", b"\xfe\xff"):
        if data.startswith(mark):
            return data.decode("utf-16", errors="replace")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        return data.decode("latin-1")


# Yarns of a Weaving Information File: their colours, spacing and thickness, sparse or not.

UNITS = {
    "centimeters": 0.01, "centimeter": 0.01, "centimetres": 0.01, "cm": 0.01,
    "inches": 0.0254, "inch": 0.0254, "in": 0.0254,
    "decipoints": 0.0254 / 720, "decipoint": 0.0254 / 720,
}  # fmt: skip
"""Lengths [m]; a decipoint is a tenth of a point."""
UNDYED = (1.0, 1.0, 1.0)


@dataclass(frozen=True)
class Yarns:
    """The yarns of one direction; arrays are None if the file lacks them.

    colour     (n, 3)  sRGB in [0, 1]
    spacing    (n,)    from the middle of a yarn's gap to the next one [m]
    thickness  (n,)    [m]
    colourless         whether it refers to colours that it does not define
    """

    colour: Float | None
    spacing: Float | None
    thickness: Float | None
    colourless: bool = False


def read_yarns(sections: Sections, name: str, number: int) -> Yarns:
    """Read colours, spacing and thickness of WARP or WEFT."""
    section = sections.get(name)
    units = section.get("UNITS")
    unit = UNITS.get(units.bare.lower()) if units else None
    if units and unit is None:
        units.refuse("an unknown unit", "centimeters, inches or decipoints")
    spacing, thickness = (
        None if unit is None else _read_lengths(section, sections.get(f"{name} {what}"), what, unit, number)
        for what in ("SPACING", "THICKNESS")
    )
    colour = _read_colours(sections, section, number)
    listed = [line for _, line in sections.get(f"{section.name} COLORS").numbered(number, "yarn", beyond=True)]
    coloured = [line for line in (section.get("COLOR"), *listed) if line and any(line.wholes(0, 10**9, "a colour"))]
    return Yarns(colour, spacing, thickness, bool(coloured) and colour is None)


def _read_lengths(section: Section, listed: Section, what: str, unit: float, number: int) -> Float | None:
    """Return lengths (number,) [m], where 0 is unknown, or None if a yarn has none."""
    default = section.get(what)
    values = np.full(number, default.real(f"a {what.lower()}") if default else 0.0)
    for key, line in listed.numbered(number, "yarn", beyond=True):
        values[key - 1] = (line.real(f"a {what.lower()}") if line.bare else 0.0) or values[key - 1]
    return values * unit if values.all() else None


def _read_colours(sections: Sections, section: Section, number: int) -> Float | None:
    """Return sRGB (number, 3) in [0, 1], or None without a colour table and written-out colours."""
    palette = Palette(sections)
    default = section.get("COLOR")
    listed = sections.get(f"{section.name} COLORS")
    default_colour = palette.find(default) if default else None
    colours = np.tile(np.array(default_colour or UNDYED), (number, 1))
    any_known = default_colour is not None
    for key, line in listed.numbered(number, "yarn", beyond=True):
        colour = palette.find(line)
        if colour is not None:
            colours[key - 1], any_known = colour, True
    return colours if any_known or palette.table else None


Colour = tuple[float, ...]


class Palette:
    """A file's colours by number, scaled from its range (0 to 255 by default) to [0, 1]."""

    def __init__(self, sections: Sections) -> None:
        """Read the table. Raises BadInput for an empty range and colours outside of it."""
        stated = sections.get("COLOR PALETTE").get("RANGE")
        limits = stated.wholes(0, 10**9, "a range of colours") if stated else [0, 255]
        bounds = [0, *limits] if len(limits) == 1 else limits
        if stated and not (len(bounds) == 2 and bounds[0] < bounds[1]):
            stated.refuse("not a range of colours", "two numbers, the smaller first, such as 0,255")
        self.low, self.high = bounds
        table = sections.get("COLOR TABLE")
        self.table = {key: self._scale(line, 0) for key, line in table.numbered(10**9, "colour") if line.bare}

    def find(self, line: Entry) -> Colour | None:
        """Return the colour that a line refers to by number, or writes out after it; None for 0. Raises BadInput."""
        numbers = line.wholes(0, 10**9, "a colour")
        if not numbers or (numbers[0] == 0 and len(numbers) == 1):
            return None
        if numbers[0] in self.table:
            return self.table[numbers[0]]
        if len(numbers) == 4:
            return self._scale(line, 1)
        if self.table:
            line.refuse("a colour that is not in [COLOR TABLE]", f"one of its {len(self.table)} colours")
        return None

    def _scale(self, line: Entry, start: int) -> Colour:
        values = line.wholes(0, 10**9, "a colour")[start:]
        if len(values) != 3 or not all(self.low <= value <= self.high for value in values):
            line.refuse("not a colour", f"three numbers from {self.low} to {self.high}, the palette's range")
        return tuple((value - self.low) / (self.high - self.low) for value in values)


# Drafts from Weaving Information Files (WIF 1.1, Nielsen et al. 1997), as weaving programs write them.
#
# A threading gives the shafts of each warp end. The shafts that move at a pick follow from a treadling and a tie-up, or
# from a lift plan; if a file has all three the first two count. Sections may be sparse: an end or a pick that is not
# listed has its section's default, no shaft or no treadle.

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
    # More than a drawdown can have are refused before allocation.
    own = [sections.need(name, "says how many yarns there are").need("THREADS") for name in ("WARP", "WEFT")]
    ends = own[0].whole(1, MOST_YARNS, "a number of yarns")
    picks = own[1].whole(1, min(MOST_YARNS, MOST_CROSSINGS // ends), f"a number of yarns across {ends} ends")
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


# Drafts of drawn weaves: a loom for a drawdown, and its file.

MOST_TREADLES = 32
"""The most treadles of a written tie-up; with more, as on dobby looms, a plan says which shafts each pick lifts."""


def find_loom(drawdown: Bool) -> Loom:
    """Return a loom that weaves a drawdown (picks, ends): equal ends hang on one shaft, equal picks press one treadle,
    both numbered as they first occur. Beyond MOST_TREADLES the picks have a lift plan.
    """
    (threading, ends), (pressed, picks) = _group_alike(drawdown.T), _group_alike(drawdown)
    lifts = drawdown[:, ends]
    return Loom(threading, pressed, lifts[picks]) if len(picks) <= MOST_TREADLES else Loom(threading, lifts, None)


def _group_alike(rows: Bool) -> tuple[Bool, NDArray[np.intp]]:
    """Return which kind each row is (rows, kinds), kinds in the order of their first rows, and these rows (kinds,)."""
    _, first, kind = np.unique(rows, axis=0, return_index=True, return_inverse=True)
    order = np.argsort(first)
    return kind[:, None] == order, first[order]


def write_wif(loom: Loom) -> str:
    """Return the text of a file of a loom, with neither colours nor spacing of yarns."""
    plan = loom.tie_up is None
    tables = {"THREADING": loom.threading, "TIEUP": loom.tie_up, "LIFTPLAN" if plan else "TREADLING": loom.pressed}
    shafts, treadles = loom.threading.shape[1], 0 if plan else loom.pressed.shape[1]
    sections = {
        "WEAVING": [f"Shafts={shafts}", f"Treadles={treadles}", "Rising Shed=true"],
        "WARP": [f"Threads={len(loom.threading)}"], "WEFT": [f"Threads={len(loom.pressed)}"],
    }  # fmt: skip
    for name, table in tables.items():
        if table is not None:
            rows = (",".join(map(str, np.flatnonzero(row) + 1)) or "0" for row in table)
            sections[name] = [f"{number}={row}" for number, row in enumerate(rows, 1)]
    head = ["Version=1.1", "Date=April 20, 1997", "Developers=wif@mhsoft.com", "Source Program=nuno"]
    sections = {"WIF": head, "CONTENTS": [f"{name}=true" for name in sections]} | sections
    return "\n".join("\n".join([f"[{name}]", *lines, ""]) for name, lines in sections.items())
