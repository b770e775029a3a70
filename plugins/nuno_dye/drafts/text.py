"""The text of a Weaving Information File: sections of key=value lines, and their values.

Names are case-insensitive, `;` starts a comment, except in text. The last of duplicate keys counts.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NoReturn

from nuno_schemas.errors import BadInput

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
