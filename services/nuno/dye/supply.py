"""Supplies of dye during a dyeing: their times, the account of their amounts, the content of finite baths.

A rinse is a supply with a negative amount.

Times are whole steps: a supply begins, and ends, with the first step that starts at its time or after it. A maintained
supply raises its cells once at its start; then the solver maintains them (`DyeSystem.supply`). A finite bath and
its cells are brought to equal shares at its start and after every step, so that its error is of the order of a
step, as the explicit scheme's own is.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from nuno_schemas.dye import DyeState, Supply
from nuno_schemas.fabric import Bool, Float, Int

ROUNDING = 1e-9
"""Relative tolerance of a time that is a whole number of steps."""
ROW = 1024
"""Length of the rows that are added at once."""
AT_THE_START = "at the start"
"""Name of the amounts in a cloth's own arrays."""


class Given(NamedTuple):
    """New amounts (2, ny, nx), and the total given amount, negative if taken."""

    phi: Float
    given: float


def give(phi: Float, room: Float, cells: Bool, amount: float) -> Given:
    """Raise cells (2, ny, nx) to a share of their room V_u; cells with more do not change."""
    raised = np.where(cells, np.maximum(phi, amount * room), phi)
    return Given(raised, math.fsum((raised - phi)[cells].tolist()))


def rinse(phi: Float, cells: Bool, share: float) -> Given:
    """Take a share of the mobile dye from cells (2, ny, nx)."""
    left = np.where(cells, (1.0 - share) * phi, phi)
    return Given(left, -math.fsum((phi - left)[cells].tolist()))


class Exchange(NamedTuple):
    """New amounts (n,), the bath's content as a share of its capacity, and the amount that it gave."""

    phi: Float
    share: float
    given: float


def exchange(phi: Float, room: Float, share: float, volume: float) -> Exchange:
    """Exchange immersed cells (n,) with a well stirred bath of finite volume, to equal shares.

    With sum V the room of the cells, and the bath's volume W in the same unit, both settle at

        s = (W share + sum phi) / (W + sum V).
    """
    total = add_up(room)
    if total == 0.0:
        return Exchange(phi, share, 0.0)
    settled = min(1.0, (volume * share + add_up(phi)) / (volume + total))
    return Exchange(settled * room, settled, volume * (share - settled))


def add_up(values: Float) -> float:
    """Sum a flat array in a fixed order: equal bits on every machine, and ten times as fast as fsum."""
    total = np.zeros(min(ROW, values.size))
    for start in range(0, values.size, ROW):
        row = values[start : start + ROW]
        total[: row.size] += row
    return math.fsum(total.tolist())


def first_step(time: float, dt: float) -> float:
    """Return the first step of dt [s] that starts at a time [s] or after it; inf for never."""
    at = time / dt
    if not math.isfinite(at):
        return math.inf
    return float(round(at) if abs(at - round(at)) <= ROUNDING * max(1.0, at) else math.ceil(at))


@dataclass
class Entry:
    """A supply in whole steps: it acts from `first` up to `last`, once if they are equal."""

    supply: Supply
    dyes: tuple[int, ...]
    """Indices of its dyes."""
    name: str
    first: float
    last: float
    volume: float
    """Volume of a finite bath, liquor times the room of its cells, in full cells; 0 for others."""
    share: float
    """Content of a finite bath, as a share of its volume."""
    places: Int
    """Cells (n,) of a finite bath, in the flat array of one dye."""
    begun: bool = False
    """Whether it has begun: a rinse takes its share once."""

    def acts(self, step: int) -> bool:
        """Return whether the supply acts in a step."""
        return self.first <= step < self.last

    @property
    def finite(self) -> bool:
        return self.supply.liquor is not None


class Supplies:
    """All supplies of a run, and the account of their amounts."""

    def __init__(self, supplies: Sequence[Supply], room: Float, dt: float, dyes: int) -> None:
        self.room, self.dt = room, dt
        self.entries: list[Entry] = []
        self.given: list[dict[str, float]] = [{} for _ in range(dyes)]
        """Amounts of each dye by supply. Supplies that are maintained at the same time share a name."""
        self._kept: tuple[tuple[int, ...], Float | None] = (), None
        for supply in supplies:
            self.add(supply)

    def add(self, supply: Supply, earliest: int = 0) -> None:
        """Append a supply, which begins at the step `earliest` or later."""
        first = max(float(earliest), first_step(supply.start, self.dt))
        last = first if supply.stop is None else max(first, first_step(supply.stop, self.dt))
        name = f"supply[{len(self.entries)}] {supply.kind}"
        volume, places = 0.0, np.zeros(0, np.int32)
        if supply.liquor is not None:
            places = np.flatnonzero(supply.cells).astype(np.int32)
            volume = supply.liquor * add_up(self.room.ravel()[places])
        dyes = tuple(range(len(self.given))) if supply.dye is None else (supply.dye,)
        self.entries.append(Entry(supply, dyes, name, first, last, volume, supply.amount, places))

    def begin(self, phi: Float, step: int) -> bool:
        """Apply supplies that start with a step to phi (dyes, 2, ny, nx), once; return whether it changed."""
        old_accounts = [dict(account) for account in self.given]
        for entry in self.entries:
            if entry.first != step or (entry.finite and not entry.acts(step)):
                continue
            supply = entry.supply
            for dye in entry.dyes:
                if entry.finite:
                    self._exchange(phi, dye, entry)
                elif supply.rinsed is None:
                    phi[dye], given = give(phi[dye], self.room, supply.cells, supply.amount)
                    self.note(dye, entry.name, given)
                elif not entry.begun:
                    phi[dye], given = rinse(phi[dye], supply.cells, supply.rinsed)
                    self.note(dye, entry.name, given)
            entry.begun = True
        return self.given != old_accounts

    def until(self, step: int, end: int) -> int:
        """Return the step, at most `end`, up to which the solver can go on from `step` alone."""
        if any(entry.finite and entry.acts(step) for entry in self.entries):
            return step + 1
        edges = (edge for entry in self.entries for edge in (entry.first, entry.last) if step < edge < end)
        return int(min(edges, default=end))

    def keep_ever(self) -> Float | None:
        """Return the largest amounts (dyes, 2, ny, nx) that the solver ever has to maintain, None for none."""
        kept = [i for i, entry in enumerate(self.entries) if entry.supply.stop is not None and not entry.finite]
        return self._least(kept) if kept else None

    def keep(self, step: int) -> Float | None:
        """Return the least amounts (dyes, 2, ny, nx) after a step, None without maintained supplies."""
        acting = tuple(i for i, entry in enumerate(self.entries) if not entry.finite and entry.acts(step))
        if acting != self._kept[0]:
            self._kept = acting, self._least(acting) if acting else None
        return self._kept[1]

    def _least(self, acting: Sequence[int]) -> Float:
        least = np.zeros((len(self.given), *self.room.shape))
        for entry in (self.entries[i] for i in acting):
            full = np.where(entry.supply.cells, entry.supply.amount * self.room, 0.0)
            for dye in entry.dyes:
                np.maximum(least[dye], full, out=least[dye])
        return least

    def end(self, phi: Float, step: int, supplied: Sequence[float]) -> bool:
        """Account for the amounts that the solver supplied in the steps since `step`, and exchange with finite baths.

        Return whether there were baths, and phi has changed.
        """
        for dye, amount in enumerate(supplied):
            names = [e.name for e in self.entries if dye in e.dyes and not e.finite and e.acts(step)]
            if names:
                self.note(dye, " and ".join(names), amount)
        baths = [entry for entry in self.entries if entry.finite and entry.acts(step)]
        for entry in baths:
            for dye in entry.dyes:
                self._exchange(phi, dye, entry)
        return bool(baths)

    def note(self, dye: int, name: str, amount: float) -> None:
        """Add an amount to the account."""
        if amount:
            self.given[dye][name] = self.given[dye].get(name, 0.0) + amount

    def _exchange(self, phi: Float, dye: int, entry: Entry) -> None:
        places = entry.places
        amounts, room = phi[dye].reshape(-1), self.room.reshape(-1)
        amounts[places], entry.share, given = exchange(amounts[places], room[places], entry.share, entry.volume)
        self.note(dye, entry.name, given)

    def most(self, state: DyeState) -> DyeState:
        """Return upper bounds of the amounts, which a solver needs beforehand."""
        phi = state.phi.copy()
        for entry in self.entries:
            share = 1.0 if entry.finite else entry.supply.amount
            full = np.where(entry.supply.cells, share * self.room, 0.0)
            for dye in entry.dyes:
                np.maximum(phi[dye], full, out=phi[dye])
        return DyeState(phi, state.fixed, state.t)

    @property
    def total(self) -> tuple[float, ...]:
        """Total supplied amount by dye."""
        return tuple(math.fsum(account.values()) for account in self.given)

    @property
    def gross(self) -> tuple[float, ...]:
        """Total supplied amount by dye, without losses to rinses and finite baths."""
        return tuple(math.fsum(amount for amount in account.values() if amount > 0.0) for account in self.given)

    def change_room(self, room: Float) -> None:
        """Replace the room of the cells (2, ny, nx); baths keep their volume."""
        self.room, self._kept = room, ((), None)

    def begun(self, step: int) -> dict[str, float]:
        """Return the shares of finite baths that began before a step, by name, as part of its state."""
        return {entry.name: entry.share for entry in self.entries if entry.finite and entry.first < step}

    def ahead(self, step: int) -> dict[str, float]:
        """Return the start times [s] of supplies that a run which ends at a step does not reach, by name."""
        return {entry.name: entry.supply.start for entry in self.entries if entry.first >= max(step, 1)}

    def save(self, step: int) -> dict[str, Any]:
        """Return state and account at the start of a step, exactly, for JSON."""
        volumes = {entry.name: entry.volume for entry in self.entries if entry.finite}
        return {"baths": self.begun(step), "volumes": volumes, "given": self.given}

    def restore(self, saved: dict[str, Any], step: int) -> None:
        """Restore saved supplies. Raises ValueError, KeyError, TypeError or AttributeError where they do not fit."""
        baths, given = dict(saved["baths"]), list(saved["given"])
        if baths.keys() != self.begun(step).keys() or len(given) != len(self.given):
            raise ValueError(f"baths {', '.join(baths) or 'none'}, and {len(given)} dyes")
        for entry in self.entries:
            # Supplies at step 0 act before any step, and so before any checkpoint.
            entry.begun = entry.first < max(step, 1)
            entry.share = float(baths.get(entry.name, entry.share))
            if entry.finite:
                # A resist that was added before the bath has left room for the dye of that time.
                entry.volume = float(saved["volumes"][entry.name])
        self.given = [{str(name): float(amount) for name, amount in account.items()} for account in given]
