"""Simulation of a scene's dye, frame by frame, independent of the bus."""

from __future__ import annotations

import math
import os
import time
from collections import Counter
from collections.abc import Sequence
from copy import deepcopy
from dataclasses import replace
from math import fsum
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nuno.bus.encodings import decode_arrays, encode_arrays
from nuno.dye.painter import check_picture
from nuno.dye.supply import AT_THE_START, Entry, Supplies
from nuno.formatting import duration
from nuno.recording.recorded import Arrays, Checkpoint
from nuno.runtime.stepper import Stepped, Stepper, copy_into, require_memory
from nuno.scene import scene_file, yaml_lines
from nuno.scene.files import SceneFiles
from nuno.scene.scene_file import Loaded
from nuno.scene.step import choose_step
from nuno.scene.validation_errors import UNNUMBERED
from nuno_schemas.dye import Cells, Dye, DyeReport, DyeState, DyeSystem, Supply
from nuno_schemas.errors import BadInput, nearest
from nuno_schemas.fabric import Float, Memory
from nuno_schemas.messages import CONCENTRATION, DYE_CHECKPOINT, DYE_STATUS, Event

BYTES_PER_CELL, BYTES_PER_AMOUNT = 150, 150
"""Most memory of a run per cell: the cloth and its faces, and for each dye amounts, bands and messages; and a byte for
each supply."""


def estimate_memory(loaded: Loaded) -> tuple[int, int]:
    """Return the number of the cloth's cells, and the most memory of a run [bytes]. Raises BadInput."""
    cloth, dyes = loaded.dyed.cloth, loaded.dyed.said.dyes
    with loaded.errors_at("dye.cloth"):
        cells = int(cloth.plugin.count(cloth.config, loaded.files))
    supplies = len(getattr(cloth.config, "supply", ()))
    return cells, cells * (BYTES_PER_CELL + supplies + len(dyes) * BYTES_PER_AMOUNT)


class DyeRun(Stepper):
    """A scene's cloth, its dyes, their solver and their amounts."""

    part, service = "dye", "dye"
    status, published, kept = DYE_STATUS, CONCENTRATION, DYE_CHECKPOINT
    quantities = MappingProxyType({"phi": "mobile dye", "fixed": "fixed dye"})

    def __init__(self, loaded: Loaded, threads: int, steps: int = 0, leave: NDArray[np.int64] | None = None) -> None:
        """`steps` a frame, stable or not; 0 takes the scene's; `leave` as in System. Raises BadInput."""
        chosen, dye = loaded.dyed, loaded.dyed.said
        self.loaded, self.frame, self.names = loaded, 0, tuple(one.name for one in dye.dyes)
        self.leave = np.zeros(1, np.int64) if leave is None else leave
        self.speed = dye.speed
        self._solver = chosen.solver
        self.threads = threads or os.cpu_count() or 1
        self.cells, self.state, added = build_cloth(loaded)
        check_picture(loaded, self.cells)
        self._resist = self.cells.resist
        """B of the scene; dyed cells may have less of a resist that was added later."""
        self.resisted = 0
        """Number of changes of B since the start."""
        laws = [law.plugin.prepare(law.config) if law is not None else None for law in chosen.isotherms]
        dyes = (
            # D_ab / d^2 is a rate of yarn and liquor, whatever the size of the cells they are cut into.
            Dye(one.name, one.D0, one.adsorption * self.cells.coarser**2, law, one.weisz_zollinger, one.uptake)
            for one, law in zip(dye.dyes, laws, strict=True)
        )
        self.system = DyeSystem(self.cells, tuple(dyes), self.threads, leave=self.leave)
        self._keeping = self.system
        """The system with the supplies that are maintained now. Solvers cache results while the system is the same."""
        with loaded.errors_at("dye.solver"):
            self.limit = float(self._solver.plugin.limit(self._solver.config, self.system))
            frame = dye.speed / loaded.scene.frame_rate
            self.steps, self.dt = (
                (steps, frame / steps) if steps else choose_step(loaded, self.limit, self._resolved(added), dyed=True)
            )
            supplies = Supplies(added, self.cells.mobile_room, self.dt, len(dye.dyes))
            self.memory = self._prepare(supplies)
        start = self.measure()
        if (kept := supplies.keep_ever()) is not None:
            self.measure(kept)
        for k, pair in enumerate(zip(start.mobile, start.fixed, strict=True)):
            supplies.note(k, AT_THE_START, fsum(pair))
        self.supplies = supplies
        self.supplies.begin(self.state.phi, 0)

    def _resolved(self, supplies: Sequence[Supply]) -> float:
        """Return the longest step [s] in which cells in a finite bath pass on at most their dye, d^2 / (2 D0 g); inf
        without such a bath.

        It exchanges with its cells only between steps: with longer ones it would give too slowly.
        """
        dyes = [self.system.dyes[one.dye] for one in supplies if one.liquor is not None and one.dye is not None]
        fastest = max((one.D0 * one.steepest for one in dyes), default=0.0)
        return self.cells.size**2 / (2.0 * fastest) if fastest > 0.0 else np.inf

    def _prepare(self, supplies: Supplies) -> Memory:
        memory: Memory = self._solver.plugin.prepare(self._solver.config, self.system, supplies.most(self.state))
        return memory

    @property
    def time(self) -> float:
        """Time of the dyeing [s], to which supplies and steps refer."""
        return self.t * self.speed

    def arrays(self) -> Arrays:
        """Return the state itself: phi and fixed (dyes, 2, ny, nx)."""
        return {"phi": self.state.phi, "fixed": self.state.fixed}

    def digested(self) -> list[NDArray[Any]]:
        """Return the arrays of the digest: amounts, and shares of finite baths."""
        return [*self.arrays().values(), np.array(list(self.supplies.begun(self.frame * self.steps).values()))]

    def encode(self) -> bytes:
        """Return the amounts as they are published, float32."""
        return encode_arrays({name: a.astype(np.float32) for name, a in self.arrays().items()}, self._text())

    def _text(self) -> dict[str, Any]:
        return {"t": self.t, "time": self.time, "frame": self.frame, "dyes": self.names}

    @staticmethod
    def decode(payload: bytes) -> Arrays:
        """Return published amounts, phi and fixed (dyes, 2, ny, nx). Raises BadMessage."""
        arrays, _ = decode_arrays(payload)
        return {name: arrays.get(name, np.zeros(0)) for name in ("phi", "fixed")}

    def place(self, index: Sequence[int]) -> str:
        """Return an index of phi or fixed in words."""
        dye, layer, row, column = index
        return f"{self.names[dye]} in the {('weft', 'warp')[layer]} of cell ({column}, {row})"

    def step(self) -> Stepped:
        """Step one frame."""
        return self.advance()

    def present(self) -> Stepped:
        """Return the present frame, without a step; compiles the kernels of a step."""
        return Stepped(self.frame, self.measure(), 0.0, self.digest())

    def measure(self, kept: Float | None = None) -> DyeReport:
        """Return the present amounts, without a step; compiles the kernels of a step, also with supplies `kept` up."""
        return self._step(kept, 0)

    def _step(self, kept: Float | None, steps: int) -> DyeReport:
        """Take steps with maintained supplies; the system is the same while they are the same."""
        if self._keeping.supply is not kept or self._keeping.cells is not self.cells:
            self._keeping = replace(self.system, supply=kept)
        report: DyeReport = self._solver.plugin.advance(self._keeping, self.state, self.memory, steps, self.dt)
        return report

    def advance(self) -> Stepped:
        """Spread dye for one frame, in pieces between which supplies begin, end or exchange."""
        begin = time.perf_counter()
        self.begin_frame()
        self.state.t = self.time
        step, end = self.frame * self.steps, (self.frame + 1) * self.steps
        totals: Counter[str] = Counter()
        taken, exchanged = 0, False
        while True:
            if self.supplies.begin(self.state.phi, step):
                # Amounts have jumped: a solver with long steps starts again, as after jumps that it detects itself.
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
        """Total supplied amount by dye."""
        return self.supplies.total

    def balance(self, report: DyeReport) -> float:
        """Return the largest |mobile + fixed - supplied| of the dyes, relative to the gross supply.

        It is nan where an amount is not finite.
        """
        amounts = zip(report.mobile, report.fixed, self.supplied, self.supplies.gross, strict=True)
        shares = [abs(fsum((mobile, fixed, -net))) / (gross or 1.0) for mobile, fixed, net, gross in amounts]
        return float(np.max(shares))

    def about(self) -> str:
        """Return how the solver's kernels run, in words."""
        return str(self._solver.plugin.about(self.system))

    def whole(self) -> tuple[Arrays, dict[str, Any]]:
        """Return arrays and text of a checkpoint, with the account of supplies, and B where it has changed."""
        arrays, text = super().whole()
        resist = {"resist": self.cells.resist} if self.resisted else {}
        return arrays | resist, self._text() | text | {"supply": self.supplies.save(self.frame * self.steps)}

    def step_back(self) -> None:
        """Go back to the start of an abandoned frame, with new memory of the solver: see StepReport.status."""
        self.memory = self._prepare(self.supplies)
        super().step_back()

    def resume(self, point: Checkpoint, changes: Sequence[Event] = ()) -> None:
        """Continue from a checkpoint, with the additions until then. Raises BadInput."""
        self.check_time(point)
        for event in changes:
            if event.frame < point.frame:
                self.frame = event.frame
                self.add(str(event.args["item"]))
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
        # Additions in the checkpoint's frame may be in it already; repeating them changes nothing.
        for event in changes:
            if event.frame == point.frame:
                self.add(str(event.args["item"]))

    def add(self, item: str) -> dict[str, Any]:
        """Add a supply or resist, `supply: {kind: drop, ...}`; return its field in the scene, and its value there.

        Raises BadInput, without any change.
        """
        previous = self.loaded
        changed, field = extend(previous, item)
        cloth = changed.dyed.cloth
        with changed.errors_at("dye.cloth"):
            supplies = cloth.plugin.supplies(cloth.config, self.cells, self.names)
            resists = cloth.plugin.resists(cloth.config, self.cells, changed.files)
        kept = {name: getattr(previous, name) for name in ("file", "lines", "files", "overrides", "path")}
        loaded = replace(changed, **kept)
        if len(supplies) > len(self.supplies.entries):
            stop = supplies[-1].stop
            if stop is not None and stop <= self.time:
                limit = f"after {self.time:g} s"
                raise BadInput("its time has passed", NAME, field=f"{field}.stop", value=stop, limit=limit)
            self.supplies.add(supplies[-1], self.frame * self.steps)
        else:
            after = 1.0 - (1.0 - self._resist) * (1.0 - resists[-1])
            self.change_resist(resist_around(self.state.phi, self.cells, self._resist, after))
            self._resist = after
        self.memory = self._prepare(self.supplies)
        self.loaded = loaded
        return {"field": field, "new": loaded.value(field)}

    def change_resist(self, resist: Float) -> None:
        """Replace the cells' B (2, ny, nx), with room for their content; the memory has to be prepared afterwards."""
        self.resisted += 1
        self.cells = replace(self.cells, resist=resist)
        self.system = replace(self.system, cells=self.cells)
        self.supplies.change_room(self.cells.mobile_room)

    def set(self, item: str) -> None:
        """Raise BadInput: cloth and law of the dyeing cannot change."""
        field = item.partition("=")[0]
        remedy = "stop, and run again with --set; nuno control RUN add gives supplies and resists"
        raise BadInput("this field cannot change while a run goes on", field=field, value=item, remedy=remedy)


def build_cloth(loaded: Loaded) -> tuple[Cells, DyeState, tuple[Supply, ...]]:
    """Build the cells, the amounts at the start, and the supplies. Raises BadInput."""
    number, size = estimate_memory(loaded)
    require_memory(loaded, "dye.cloth", number, "cells", size, "coarser: 2, larger cells, or fewer dyes")
    cloth, dyes = loaded.dyed.cloth, [one.name for one in loaded.dyed.said.dyes]
    with loaded.errors_at("dye.cloth"):
        plugin, config = cloth.plugin, cloth.config
        cells, state = plugin.build(config, loaded.files, loaded.scene.seed, dyes)
        return cells, state, plugin.supplies(config, cells, dyes)


# Supplies and resists that are added to a dyeing during its run.

PLACES = ("supply", "resist")
"""Lists of `dye.cloth` that take another item."""
NAME = "add"
"""Name of an added item's text in errors."""
MARGIN = 4.0 * np.finfo(np.float64).eps
"""Relative rounding error of V_u computed from B."""


def parse(item: str) -> tuple[str, dict[str, Any]]:
    """Split `supply: {kind: drop, ...}` into supply and its fields. Raises BadInput."""
    value = yaml_lines.parse_value(item)
    if not isinstance(value, dict) or len(value) != 1:
        remedy = "for example supply: {kind: drop, place: [5 mm, 5 mm], diameter: 1 mm}"
        raise BadInput("add takes one supply or one resist", NAME, value=item, remedy=remedy)
    place, fields = next(iter(value.items()))
    if place not in PLACES:
        raise BadInput("this cannot be added to a run", NAME, field=place, remedy=nearest(place, PLACES))
    return place, fields


def extend(loaded: Loaded, item: str) -> tuple[Loaded, str]:
    """Return the scene with one more item, and the item's field, `dye.cloth.supply[2]`.

    Errors of the new scene are errors of the item, and have NAME as file. Raises BadInput.
    """
    place, fields = parse(item)
    data = deepcopy(loaded.data)
    items = data["dye"]["cloth"].setdefault(place, [])
    items.append(fields)
    path: yaml_lines.Path = ("dye", "cloth", place, len(items) - 1)
    lines = dict.fromkeys([*loaded.lines, *(place for place, _ in yaml_lines.walk(fields, path))], UNNUMBERED)
    files = RecordedFiles(loaded.files.folder, loaded.files.roots, loaded.files.used)
    return scene_file.load(data, lines, NAME, files), yaml_lines.dotted(path)


class RecordedFiles(SceneFiles):
    """The files that a run has used, which its recording includes."""

    def resolve(self, name: str) -> Path:
        """Return a used file. Raises BadInput for others, with which the recording could not be replayed."""
        if name not in self.used:
            allowed = (
                f"images that the scene names ({', '.join(self.used)})" if self.used else "no image: the scene has none"
            )
            raise BadInput(
                "the file is not in the run's recording, which could not be replayed", value=name,
                remedy=f"an added resist may use {allowed}; or a shape, a paste, a binding",
            )  # fmt: skip
        return self.used[name]


def resist_around(phi: Float, cells: Cells, before: Float, after: Float) -> Float:
    """Return B (2, ny, nx) after a resist is added to dyed cells: it takes only the free room.

    `before` and `after` are B of the scene without and with it, phi (dyes, 2, ny, nx). With phi <= V_max P (1 - B)

        B <= 1 - phi / (V_max P),

    and B, which may have found less room than `before` allows, is never lowered.
    """
    room, most = cells.v_max * cells.porosity, phi.max(axis=0)
    free = np.ones_like(room)
    np.divide(most, room, out=free, where=most > 0.0)
    np.subtract(1.0, free * (1.0 + MARGIN) + MARGIN, out=free, where=most > 0.0)
    return np.asarray(np.where(after > before, np.maximum(cells.resist, np.clip(free, 0.0, after)), cells.resist))


# The plan of a dyeing, for `nuno plan`: size, step, and cost estimated from a frame.


def describe_dye(loaded: Loaded) -> list[tuple[str, str]]:
    """Return rows (heading, text). Raises BadInput for a scene that would not start."""
    dyeing = DyeRun(loaded, 0)
    laws = {chosen.field: chosen.name for chosen in loaded.chosen}
    return [
        (
            "dye cloth" if loaded.scene.moves else "cloth",
            f"{f'on {on}, ' if (on := loaded.dyed.said.object) else ''}{_size(dyeing)}",
        ),
        ("dyes", ", ".join(_dye(one, laws.get(f"dye.dyes[{i}].isotherm")) for i, one in enumerate(dyeing.system.dyes))),
        *([("supply", "; ".join(map(_supply, dyeing.supplies.entries)))] if dyeing.supplies.entries else []),
        ("solver", f"{dyeing.describe_step(loaded.dyed.solver.name, dyeing.limit)}; {dyeing.about()}"),
        *_cost(dyeing, loaded),
    ]


def _dye(one: Dye, isotherm: str | None) -> str:
    law = isotherm or (one.isotherm.kind if one.isotherm is not None else "")
    law = law if law and one.adsorption else "nothing is fixed"
    slower = one.weisz_zollinger
    factor = f" x min({slower.cap:g}, {slower.phi0:g} / phi)" if slower is not None else ""
    return f"{one.name} (D0 {one.D0 * 3.6e9:.4g} mm^2/h{factor}, {law})"


def _size(dyeing: DyeRun) -> str:
    _, ny, nx = dyeing.cells.fibre.shape
    size = dyeing.cells.size * 1e3
    larger = f", {dyeing.cells.coarser} times as large as given" if dyeing.cells.coarser > 1 else ""
    return f"{nx * size:.4g} mm x {ny * size:.4g} mm: {2 * ny * nx:,} cells of {size:.4g} mm{larger}, in two layers"


def _supply(entry: Entry) -> str:
    one = entry.supply
    times = f"at {duration(one.start)}"
    if one.stop is not None:
        times = f"{duration(one.start)} to {'the end' if math.isinf(one.stop) else duration(one.stop)}"
    return f"{one.kind} {times}{', exhausted' if entry.finite else ''}"


def _cost(dyeing: DyeRun, loaded: Loaded) -> list[tuple[str, str]]:
    scene, memory, rare = loaded.scene, estimate_memory(loaded)[1], loaded.scene.record.dye_every
    shown = scene.frames if rare is None else min(scene.frames, int(scene.duration / rare) + dyeing.checkpoints)
    size = (8 * (shown + 1) + 16 * dyeing.checkpoints) * dyeing.state.phi.size
    speed = f", {duration(scene.frames / scene.frame_rate * dyeing.speed)} of dyeing" if dyeing.speed != 1.0 else ""
    return dyeing.describe_cost(dyeing.time_frame(), size, memory, speed)
