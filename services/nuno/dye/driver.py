"""Frames of dye in lockstep: dye is spread and published."""

from __future__ import annotations

import math
import time
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nuno.dye.run import DyeRun, Frame
from nuno.service import Context
from nuno.wire.arrays import encode_arrays
from nuno.wire.lockstep import WINDOW, Lockstep
from nuno_schemas.dye import DyeReport
from nuno_schemas.messages import CLOTH, CONCENTRATION, DYE_CHECKPOINT, DYE_STATUS, STATUS, DyeStatus


class Driver(Lockstep):
    """Runs a dyeing frame by frame: leads and answers control, or follows the simulation of what is dyed."""

    def __init__(self, context: Context, dyeing: DyeRun) -> None:
        super().__init__(context, dyeing, STATUS if context.loaded.scene.moves else None)
        self.dyeing = dyeing
        every = self.scene.record.dye_every
        self.every = 1 if every is None else self.scene.in_frames(every)
        """Frames from one whose amounts are published to the next."""
        self.shown: list[int] = []
        """Frames whose amounts were."""
        self.balance = 0.0
        self.amounts: dict[str, dict[str, float | None]] = {}

    def publish_start(self) -> None:
        """The cloth, and the amounts before the first step."""
        self.publish_cloth()
        dyeing = self.dyeing
        frame = Frame(dyeing.frame, dyeing.measure(), 0.0, dyeing.digest())
        self.publish_amounts(frame.digest)
        self.publish(frame, "running")

    def publish_cloth(self) -> None:
        """What viewers and recordings need to know about the cloth: at the start, and when it has changed."""
        dyeing, cells = self.dyeing, self.dyeing.cells
        arrays: dict[str, NDArray[Any]] = {"fibre": cells.fibre, "up": cells.up} | {
            name: np.asarray(getattr(cells, name), np.float32) for name in ("porosity", "twist", "resist")
        }
        if cells.yarns is not None:
            arrays |= {"weft_yarn": cells.yarns[0], "warp_yarn": cells.yarns[1]}
        if cells.ground is not None:
            arrays |= {"weft_colour": cells.ground[0], "warp_colour": cells.ground[1]}
        if cells.photograph is not None:
            arrays |= {"photograph": cells.photograph.light, "photograph_warp": cells.photograph.warp}
        text = {"scene": self.scene.name, "cell_size": cells.size, "v_max": cells.v_max, "dyes": dyeing.names}
        text["object"] = self.scene.dye.object if self.scene.dye is not None else None
        self.context.bus.publisher(CLOTH).put(encode_arrays(arrays, text), dyeing.frame, dyeing.t)

    def add(self, item: str) -> dict[str, Any]:
        """See `Lockstep`; a cloth with more resist is published again."""
        resist = self.dyeing.cells.resist
        change = super().add(item)
        if self.dyeing.cells.resist is not resist:
            self.publish_cloth()
        return change

    def step_frame(self) -> DyeReport:
        """Spread, publish."""
        frame = self.dyeing.advance()
        self.seconds["steps"] += frame.seconds
        if frame.number % self.every == 0 or frame.report.status != "ok":
            self.publish_amounts(frame.digest)
        self.publish(frame, "running" if frame.report.status == "ok" else frame.report.status)
        return frame.report

    def shown_until(self, frame: int) -> int:
        """See `Lockstep`."""
        return next((shown for shown in reversed(self.shown) if shown <= frame), -1)

    def publish_amounts(self, digest: str) -> None:
        """What the cells hold, as float32."""
        start, dyeing = time.perf_counter(), self.dyeing
        arrays = {name: getattr(dyeing.state, name).astype(np.float32) for name in ("phi", "fixed")}
        amounts = encode_arrays(arrays, self._text(dyeing.frame))
        self.shown = [*self.shown[-WINDOW:], dyeing.frame]
        self.seconds["encoding"] += time.perf_counter() - start
        self.context.bus.publisher(CONCENTRATION).put(amounts, dyeing.frame, dyeing.t, digest)

    def publish(self, frame: Frame, state: str) -> None:
        """The totals of the amounts."""
        start = time.perf_counter()
        dyeing, bus, report = self.dyeing, self.context.bus, frame.report
        balance = dyeing.balance(report)
        self.balance = max(self.balance, balance) if math.isfinite(balance) else math.nan
        totals = {"mobile": report.mobile, "fixed": report.fixed, "supplied": dyeing.supplied}
        self.amounts = {
            name: {one: _finite(value) for one, value in zip(dyeing.names, values, strict=True)}
            for name, values in totals.items()
        }
        status = DyeStatus.model_validate(
            {
                "frame": frame.number,
                "t": dyeing.t,
                "time": dyeing.time,
                "digest": frame.digest,
                "state": state,
                "steps": report.steps,
                "step_seconds": frame.seconds,
                "message": report.message,
                "balance": _finite(balance),
                **self.amounts,
            }
        )
        self.seconds["encoding"] += time.perf_counter() - start
        bus.publisher(DYE_STATUS).put(status.model_dump_json().encode(), frame.number, dyeing.t, frame.digest)

    def _text(self, frame: int) -> dict[str, Any]:
        return {"t": self.dyeing.t, "time": self.dyeing.time, "frame": frame, "dyes": self.dyeing.names}

    def publish_checkpoint(self) -> None:
        """The float64 amounts and the solver's memory, enough to go on from in the same bits.

        The amounts of this frame are shown, too: a resumed run then shows what an unbroken one does.
        """
        dyeing = self.dyeing
        digest = dyeing.digest()
        if self.shown[-1] != dyeing.frame:
            self.publish_amounts(digest)
        arrays: dict[str, NDArray[Any]] = {"phi": dyeing.state.phi, "fixed": dyeing.state.fixed}
        arrays |= {f"memory/{name}": values for name, values in dyeing.memory.arrays.items()}
        if dyeing.resisted:
            arrays["resist"] = dyeing.cells.resist
        text = self._text(dyeing.frame) | {
            "digest": digest,
            "dt": dyeing.dt,
            "steps": dyeing.steps,
            "supply": dyeing.supplies.save(dyeing.frame * dyeing.steps),
        }
        self.context.bus.publisher(DYE_CHECKPOINT).put(encode_arrays(arrays, text), dyeing.frame, dyeing.t, digest)

    def facts(self, ended: str) -> dict[str, Any]:
        """Amounts, balance, limits and sizes for the report."""
        dyeing = self.dyeing
        return {
            "steps_per_frame": dyeing.steps,
            "dt": dyeing.dt,
            "limit": {"dt": dyeing.limit},
            "threads": dyeing.about(),
            "cells": dyeing.cells.fibre.size,
            "dyes": len(dyeing.names),
            "dye": {
                **self.amounts,
                "balance": _finite(self.balance),
                "given": self.given(),
                "baths": self.baths(),
                "ahead": dyeing.supplies.ahead(dyeing.frame * dyeing.steps),
                "seconds": dyeing.time,
                "weisz_zollinger": {
                    one.name: one.weisz_zollinger.model_dump() for one in dyeing.system.dyes if one.weisz_zollinger
                },
            },
        }

    def given(self) -> dict[str, dict[str, float | None]]:
        """What came from where, by dye."""
        accounts = zip(self.dyeing.names, self.dyeing.supplies.given, strict=True)
        return {dye: {name: _finite(amount) for name, amount in account.items()} for dye, account in accounts}

    def baths(self) -> dict[str, float]:
        """What is left in finite baths, as a share of what they can hold."""
        return {entry.name: entry.share for entry in self.dyeing.supplies.entries if entry.finite}


def _finite(value: float) -> float | None:
    """A number as JSON can say it."""
    return value if math.isfinite(value) else None
