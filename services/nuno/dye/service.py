"""The dye service: steps the dyeing, and publishes its frames."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nuno.dye.run import DyeRun
from nuno.recording.reader import before_checkpoint, open_recording
from nuno.runtime.driver import Driver, FrameWatchdog
from nuno.runtime.service import Context
from nuno.runtime.stepper import Stepped, require_recorded, resume
from nuno_schemas.dye import Cells
from nuno_schemas.messages import CLOTH, DYE_STATUS, STATUS, Topic


class DyeAccount:
    """The account of a dyeing, for messages and the report: its cloth, its amounts, their balance
    (nuno.runtime.driver.Account).
    """

    def __init__(self, dyeing: DyeRun) -> None:
        self.dyeing = dyeing
        self.warnings: list[str] = []
        scene = dyeing.loaded.scene
        self.every = 1 if scene.record.dye_every is None else scene.in_frames(scene.record.dye_every)
        self.balance = 0.0
        self.amounts: dict[str, dict[str, float | None]] = {}

    @property
    def version(self) -> int:
        """Number of changes of the resist so far."""
        return self.dyeing.resisted

    def constant(self, frame: int) -> tuple[Topic, dict[str, NDArray[Any]], dict[str, Any]]:
        """Return the cloth's data for viewers and recordings."""
        dyeing, cells = self.dyeing, self.dyeing.cells
        arrays = _constant_arrays(cells)
        if cells.yarns is not None:
            arrays |= {"weft_yarn": cells.yarns[0], "warp_yarn": cells.yarns[1]}
        if cells.ground is not None:
            arrays |= {"weft_colour": cells.ground[0], "warp_colour": cells.ground[1]}
        if cells.photograph is not None:
            arrays |= {"photograph": cells.photograph.light, "photograph_warp": cells.photograph.warp}
        scene = dyeing.loaded.scene
        text = {"scene": scene.name, "cell_size": cells.size, "v_max": cells.v_max, "dyes": dyeing.names}
        text["object"] = scene.dye.object if scene.dye is not None else None
        return CLOTH, arrays, text

    def loads(self) -> tuple[tuple[Topic, bytes], ...]:
        """Dye bears on no body."""
        return ()

    def takes(self, item: str) -> bool:
        """Nothing follows dye."""
        return True

    def status_of(self, frame: Stepped) -> dict[str, Any]:
        """Return the time of the dyeing, and totals of the amounts."""
        dyeing, report = self.dyeing, frame.report
        balance = dyeing.balance(report)
        self.balance = max(self.balance, balance) if math.isfinite(balance) else math.nan
        totals = {"mobile": report.mobile, "fixed": report.fixed, "supplied": dyeing.supplied}
        self.amounts = {
            name: {one: _finite(value) for one, value in zip(dyeing.names, values, strict=True)}
            for name, values in totals.items()
        }
        return {"time": dyeing.time, "balance": _finite(balance), **self.amounts}

    def facts(self, ended: str, seconds: float) -> dict[str, Any]:
        """Return amounts, balance, limit and sizes for the report."""
        dyeing = self.dyeing
        return {
            "limit": {"dt": dyeing.limit},
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
        """Return the amount from each supply, by dye."""
        accounts = zip(self.dyeing.names, self.dyeing.supplies.given, strict=True)
        return {dye: {name: _finite(amount) for name, amount in account.items()} for dye, account in accounts}

    def baths(self) -> dict[str, float]:
        """Return the content of finite baths, as a share of their capacity."""
        return {entry.name: entry.share for entry in self.dyeing.supplies.entries if entry.finite}


def _constant_arrays(cells: Cells) -> dict[str, NDArray[Any]]:
    """Return the arrays of `dye/cloth` that all cells have."""
    fields = {name: np.asarray(getattr(cells, name), np.float32) for name in ("porosity", "twist", "resist")}
    return {"fibre": cells.fibre, "up": cells.up} | fields


def _finite(value: float) -> float | None:
    """Return a number for JSON, None if it is not finite."""
    return value if math.isfinite(value) else None


def main(context: Context) -> None:
    """Run the dye of one scene: prepare, step all frames, reply to the query for the end."""
    watchdog = FrameWatchdog(context)
    dyeing = DyeRun(context.loaded, context.options.threads, leave=watchdog.leave)
    if context.options.resume is not None:
        resume(dyeing, context.options.resume)
        with open_recording(context.options.resume) as recording:
            require_recorded(recording, CLOTH, _constant_arrays(dyeing.cells))
    account = DyeAccount(dyeing)
    balances = [one["balance"] for one in before_checkpoint(context.options.resume, [DYE_STATUS.name])]
    account.balance = math.nan if None in balances else max([0.0, *balances])
    Driver(context, dyeing, account, watchdog, STATUS if context.loaded.scene.moves else None).serve()
