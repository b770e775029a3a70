"""The dye service's work: from a scene to frames, independent of how they are sent."""

from __future__ import annotations

import os
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from math import fsum
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nuno.bus.encodings import decode_arrays, encode_arrays
from nuno.dye.add import NAME, as_run, extend, resist_around
from nuno.dye.painter import check_picture
from nuno.dye.supply import AT_THE_START, Supplies
from nuno.recording.recorded import Arrays, Checkpoint
from nuno.scene.scene_file import Loaded
from nuno.scene.step import choose_step
from nuno.stepping.stepper import Stepped, Stepper, copy_into, require_memory
from nuno_schemas.dye import Cells, Dye, DyeReport, DyeState, DyeSystem, Supply
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Float, Memory
from nuno_schemas.messages import CONCENTRATION, DYE_CHECKPOINT, DYE_STATUS, Event

BYTES_PER_CELL, BYTES_PER_AMOUNT = 150, 150
"""What a run takes at most per cell: the cloth and its faces, and for each dye amounts, bands and messages; and a
byte for each supply."""


def estimate_memory(loaded: Loaded) -> tuple[int, int]:
    """Cells that the cloth will have, and what a run of them takes at most [bytes]. Raises BadInput."""
    cloth, dyes = loaded.dyed.cloth, loaded.dyed.said.dyes
    try:
        cells = int(cloth.plugin.count(cloth.config, loaded.files))
    except BadInput as error:
        raise loaded.at("dye.cloth", error) from None
    supplies = len(getattr(cloth.config, "supply", ()))
    return cells, cells * (BYTES_PER_CELL + supplies + len(dyes) * BYTES_PER_AMOUNT)


class DyeRun(Stepper):
    """A scene's cloth, its dyes, their solver and their amounts."""

    part, service = "dye", "dye"
    status, published, kept = DYE_STATUS, CONCENTRATION, DYE_CHECKPOINT
    quantities = MappingProxyType({"phi": "mobile dye", "fixed": "fixed dye"})

    def __init__(self, loaded: Loaded, threads: int, steps: int = 0, leave: NDArray[np.int64] | None = None) -> None:
        """`steps` a frame, stable or not; 0: as the scene says; `leave` as in System. Raises BadInput."""
        chosen, dye = loaded.dyed, loaded.dyed.said
        self.loaded, self.frame, self.names = loaded, 0, tuple(one.name for one in dye.dyes)
        self.leave = np.zeros(1, np.int64) if leave is None else leave
        self.speed = dye.speed
        self._solver = chosen.solver
        self.threads = threads or os.cpu_count() or 1
        self.cells, self.state, given = build_cloth(loaded)
        check_picture(loaded, self.cells)
        self._resist = self.cells.resist
        """B as the scene has it; of what was added over dye, the cells have less."""
        self.resisted = False
        """Whether B has changed since the start."""
        laws = [law.plugin.prepare(law.config) if law is not None else None for law in chosen.isotherms]
        dyes = (
            # D_ab / d^2 is a rate of yarn and liquor, whatever the size of the cells they are cut into.
            Dye(one.name, one.D0, one.adsorption * self.cells.coarser**2, law, one.weisz_zollinger)
            for one, law in zip(dye.dyes, laws, strict=True)
        )
        self.system = DyeSystem(self.cells, tuple(dyes), self.threads, leave=self.leave)
        self._keeping = self.system
        """With what is kept up at present. Solvers hold what follows from a system as long as it is the same."""
        try:
            self.limit = float(self._solver.plugin.limit(self._solver.config, self.system))
            whole = dye.speed / loaded.scene.frame_rate
            self.steps, self.dt = (
                (steps, whole / steps) if steps else choose_step(loaded, self.limit, self._resolved(given), dyed=True)
            )
            supplies = Supplies(given, self.cells.mobile_room, self.dt, len(dye.dyes))
            self.memory = self._prepare(supplies)
        except BadInput as error:
            raise loaded.at("dye.solver", error) from None
        start = self.measure()
        if (kept := supplies.keep_ever()) is not None:
            self.measure(kept)
        for k, pair in enumerate(zip(start.mobile, start.fixed, strict=True)):
            supplies.note(k, AT_THE_START, fsum(pair))
        self.supplies = supplies
        self.supplies.begin(self.state.phi, 0)

    def _resolved(self, given: Sequence[Supply]) -> float:
        """Longest step [s] in which cells in a finite bath hand on no more than they hold, d^2 / (2 D0 g); inf without.

        Such a bath meets its cells between steps only: over longer ones it would give too slowly.
        """
        dyes = [self.system.dyes[one.dye] for one in given if one.liquor is not None and one.dye is not None]
        fastest = max((one.D0 * one.steepest for one in dyes), default=0.0)
        return self.cells.size**2 / (2.0 * fastest) if fastest > 0.0 else np.inf

    def _prepare(self, supplies: Supplies) -> Memory:
        memory: Memory = self._solver.plugin.prepare(self._solver.config, self.system, supplies.most(self.state))
        return memory

    @property
    def time(self) -> float:
        """Time of the dyeing [s], which supplies and steps count."""
        return self.t * self.speed

    def arrays(self) -> Arrays:
        """See `Stepper`: phi and fixed (dyes, 2, ny, nx)."""
        return {"phi": self.state.phi, "fixed": self.state.fixed}

    def digested(self) -> list[NDArray[Any]]:
        """See `Stepper`: amounts, and what finite baths hold."""
        return [*self.arrays().values(), np.array(list(self.supplies.begun(self.frame * self.steps).values()))]

    def encode(self) -> bytes:
        """See `Stepper`."""
        return encode_arrays({name: a.astype(np.float32) for name, a in self.arrays().items()}, self._text())

    def _text(self) -> dict[str, Any]:
        return {"t": self.t, "time": self.time, "frame": self.frame, "dyes": self.names}

    @staticmethod
    def decode(payload: bytes) -> Arrays:
        """See `Stepper`: phi and fixed (dyes, 2, ny, nx)."""
        arrays, _ = decode_arrays(payload)
        return {name: arrays.get(name, np.zeros(0)) for name in ("phi", "fixed")}

    def place(self, index: Sequence[int]) -> str:
        """See `Stepper`."""
        dye, layer, row, column = index
        return f"{self.names[dye]} in the {('weft', 'warp')[layer]} of cell ({column}, {row})"

    def step(self) -> Stepped:
        """See `Stepper`."""
        return self.advance()

    def present(self) -> Stepped:
        """See `Stepper`."""
        return Stepped(self.frame, self.measure(), 0.0, self.digest())

    def measure(self, kept: Float | None = None) -> DyeReport:
        """The present amounts, without a step; compiles what steps need, and those with supplies `kept` up."""
        return self._step(kept, 0)

    def _step(self, kept: Float | None, steps: int) -> DyeReport:
        """Steps of the solver with supplies kept up: the same system as long as they are the same."""
        if self._keeping.supply is not kept or self._keeping.cells is not self.cells:
            self._keeping = replace(self.system, supply=kept)
        found: DyeReport = self._solver.plugin.advance(self._keeping, self.state, self.memory, steps, self.dt)
        return found

    def advance(self) -> Stepped:
        """Spread dye for one frame, in pieces between which supplies begin, end or exchange."""
        begin = time.perf_counter()
        self.state.t = self.time
        step, end = self.frame * self.steps, (self.frame + 1) * self.steps
        totals: Counter[str] = Counter()
        taken, exchanged = 0, False
        while True:
            if self.supplies.begin(self.state.phi, step):
                # Amounts have jumped: a solver of long steps begins anew, as it does after what it can see itself.
                self.memory = self._prepare(self.supplies)
            until = self.supplies.until(step, end)
            kept = self.supplies.keep(step)
            report = self._step(kept, until - step)
            totals.update(report.totals)
            if self.leave[0]:
                report = replace(report, status="left")
                return Stepped(self.frame, report, time.perf_counter() - begin, self.digest())
            taken += report.steps
            exchanged = self.supplies.end(self.state.phi, step, report.supplied)
            step = until
            if step == end or report.status != "ok":
                break
        if exchanged:
            measured = self.measure(kept)
            report = replace(report, mobile=measured.mobile, fixed=measured.fixed)
        self.frame += 1
        self.state.t = self.time
        report = replace(report, totals=dict(totals), steps=taken)
        self.taken = time.perf_counter() - begin
        return Stepped(self.frame, report, self.taken, self.digest())

    @property
    def supplied(self) -> tuple[float, ...]:
        """What was supplied in all, by dye."""
        return self.supplies.total

    def balance(self, report: DyeReport) -> float:
        """Largest |mobile + fixed - supplied| of the dyes, over what was supplied before baths took any back.

        nan where an amount is not finite.
        """
        amounts = zip(report.mobile, report.fixed, self.supplied, self.supplies.gross, strict=True)
        shares = [abs(fsum((mobile, fixed, -net))) / (gross or 1.0) for mobile, fixed, net, gross in amounts]
        return float(np.max(shares))

    def about(self) -> str:
        """See `Stepper`."""
        return str(self._solver.plugin.about(self.system))

    def whole(self) -> tuple[Arrays, dict[str, Any]]:
        """See `Stepper`: with what supplies gave so far, and B where it has changed."""
        arrays, text = super().whole()
        resist = {"resist": self.cells.resist} if self.resisted else {}
        return arrays | resist, self._text() | text | {"supply": self.supplies.save(self.frame * self.steps)}

    def resume(self, point: Checkpoint, changes: Sequence[Event] = ()) -> None:
        """See `Stepper`."""
        self.check_time(point)
        for event in changes:
            if event.frame < point.frame:
                self.frame = event.frame
                self.add(str(event.args["item"]))
        self._restore(point)
        # Added at the checkpoint's frame: whether before the checkpoint or after it, once more changes nothing.
        for event in changes:
            if event.frame == point.frame:
                self.add(str(event.args["item"]))

    def _restore(self, point: Checkpoint) -> None:
        resist = point.arrays.get("resist")
        if resist is not None:
            copy_into({"resist": np.empty_like(self.cells.resist)}, {"resist": resist})
            self.change_resist(resist.copy())
            self.memory = self._prepare(self.supplies)
        self.take_over(point)
        try:
            self.supplies.restore(point.text["supply"], self.frame * self.steps)
        except (KeyError, ValueError, TypeError, AttributeError) as error:
            raise BadInput(f"the checkpoint's supplies are not those of this scene: {error}") from None
        self.state.t = self.time

    def add(self, item: str) -> str:
        """Give the cloth another supply or resist, `supply: {kind: drop, ...}`; its field in the scene.

        Raises BadInput, and has then changed nothing.
        """
        before = self.loaded
        changed, field = extend(before, item)
        cloth = changed.dyed.cloth
        try:
            given = cloth.plugin.supplies(cloth.config, self.cells, self.names)
            parts = cloth.plugin.resists(cloth.config, self.cells, changed.files)
        except BadInput as error:
            raise changed.at("dye.cloth", error) from None
        loaded = as_run(changed, before)
        if len(given) > len(self.supplies.entries):
            stop = given[-1].stop
            if stop is not None and stop <= self.time:
                limit = f"after {self.time:g} s"
                raise BadInput("its time has passed", NAME, field=f"{field}.stop", value=stop, limit=limit)
            self.supplies.add(given[-1], self.frame * self.steps)
        else:
            after = 1.0 - (1.0 - self._resist) * (1.0 - parts[-1])
            self.change_resist(resist_around(self.state.phi, self.cells, self._resist, after))
            self._resist = after
        self.memory = self._prepare(self.supplies)
        self.loaded = loaded
        return field

    def change_resist(self, resist: Float) -> None:
        """Give the cells another B (2, ny, nx) with room for what they hold; the memory is then to be prepared."""
        self.resisted = True
        self.cells = replace(self.cells, resist=resist)
        self.system = replace(self.system, cells=self.cells)
        self.supplies.change_room(self.cells.mobile_room)

    def set(self, item: str) -> None:
        """Raises BadInput: what dye spreads in and by does not change."""
        field = item.partition("=")[0]
        remedy = "stop, and run again with --set; nuno control RUN add gives supplies and resists"
        raise BadInput("this field cannot change while a run goes on", field=field, value=item, remedy=remedy)


def build_cloth(loaded: Loaded) -> tuple[Cells, DyeState, tuple[Supply, ...]]:
    """Cells, the amounts at the start and what gives dye to them. Raises BadInput."""
    number, size = estimate_memory(loaded)
    require_memory(loaded, "dye.cloth", number, "cells", size, "coarser: 2, larger cells, or fewer dyes")
    cloth, dyes = loaded.dyed.cloth, [one.name for one in loaded.dyed.said.dyes]
    try:
        plugin, config = cloth.plugin, cloth.config
        cells, state = plugin.build(config, loaded.files, loaded.scene.seed, dyes)
        return cells, state, plugin.supplies(config, cells, dyes)
    except BadInput as error:
        raise loaded.at("dye.cloth", error) from None
