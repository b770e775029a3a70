"""A simulation whose cloth operations change while it goes on."""

from __future__ import annotations

import contextlib
import json
from abc import abstractmethod
from collections.abc import Sequence
from copy import copy, deepcopy
from dataclasses import replace
from typing import Any, Self, cast

import numpy as np
from numpy.typing import NDArray

from nuno.cloth import build
from nuno.cloth.join import join_fabrics
from nuno.cloth.numbering import find_numbers, invert, keep_numbers, takes_any_numbering
from nuno.collision.distance import beside
from nuno.plugin_contract.values import ContractError, check_array
from nuno.recording.recorded import Checkpoint
from nuno.scene.chosen_plugins import Chosen
from nuno.simulation.operations import fabric_arrays, fabric_from, frames_bound, parse
from nuno.simulation.relax import Stillness
from nuno.simulation.renumbered_solver import RenumberedSolver
from nuno.stepping.stepper import Stepper, fitting
from nuno_schemas.bodies import Geometry, Poses
from nuno_schemas.errors import BadInput, nearest
from nuno_schemas.fabric import Fabric, Int, State
from nuno_schemas.layout import Bounds
from nuno_schemas.operation import Outcome, arranges
from nuno_schemas.plugin import Rested
from nuno_schemas.system import StepReport

NUMBERS = "numbers"
"""What `Changing.numbers` is called in a checkpoint."""


class Changing(Stepper):
    """Cloth, its state and its solver, and what operations have made of them."""

    geometry: Geometry | None
    start_poses: Poses | None
    poses: Poses | None
    fabric: Fabric
    pieces: list[build.Piece]
    state: State
    numbers: Int | None
    """(n,) the vertex in each place of what is stepped, None where that is the fabric as it is."""
    rested: Sequence[Rested]
    """What each object has come to rest as on fewer vertices before, if anything has."""
    stillness: Stillness
    balanced: bool

    @abstractmethod
    def measure(self, poses: Poses | None) -> StepReport:
        """The present state's energy and stretch, without a step; compiles what steps need."""

    @abstractmethod
    def _prepare(self, arrays: dict[str, NDArray[Any]], source: Int | None = None) -> None:
        """(Re)build what follows from the scene; `arrays` is memory to keep, of vertices that were `source` before: by
        the places in which they are stepped.
        """

    @property
    def solver(self) -> Chosen:
        """The scene's integrator, for states in the user's order."""
        chosen, numbers = self.loaded.integrator, self.numbers
        return chosen if numbers is None else replace(chosen, plugin=RenumberedSolver(chosen.plugin, numbers))

    def begin_unchanged(self) -> None:
        """Have the cloth of the scene."""
        self.numbers = find_numbers(self.fabric, self.pieces) if takes_any_numbering(self.loaded) else None
        self.changes: list[dict[str, Any]] = []
        """What operations did to the cloth, in their order: frame, t [s], operation, object and its facts."""
        self.applied = 0
        """Of the scene's operations."""
        self.crests: list[Int] = []
        """Of each change (5, c) vertices of its object by which its height is measured: on the line, to the left and to
        the right of it, and before and after on it; c may be 0."""
        self._fabrics: list[Fabric] | None = None
        scene = self.loaded.scene
        names = [spec.name for spec in scene.objects]
        for i, (applied, chosen) in enumerate(zip(scene.operations, self.loaded.operations, strict=True)):
            try:
                if hasattr(chosen.plugin, "require"):
                    chosen.plugin.require(chosen.config, self.parts()[names.index(applied.object or names[0])])
            except BadInput as error:
                raise self.loaded.at(f"operations[{i}]", error) from None

    def add(self, item: str) -> str:
        """Apply an operation, `wrinkle: {...}`, at once; the text that does so again. Raises BadInput."""
        index, chosen, item = parse(item, self.loaded)
        self._alter(index, chosen)
        return item

    def due(self, frame: int) -> int:
        """How many of the scene's operations have come by `frame`."""
        rate = self.loaded.scene.frame_rate
        return sum(round(float(applied.at) * rate) <= frame for applied in self.loaded.scene.operations)

    def alter_due(self) -> bool:
        """Apply the scene's operations whose time has come; whether there were any. Raises BadInput."""
        scene, before = self.loaded.scene, self.applied
        order = sorted(range(len(scene.operations)), key=lambda i: float(scene.operations[i].at))
        names = [spec.name for spec in scene.objects]
        for i in order[before : self.due(self.frame)]:
            name = scene.operations[i].object or names[0]
            try:
                if not arranges(self.loaded.operations[i].plugin):  # otherwise the cloth was built so
                    self._alter(names.index(name), self.loaded.operations[i])
            except BadInput as error:
                raise self.loaded.at(f"operations[{i}]", error) from None
            self.applied += 1
        return self.applied > before

    def rehearse(self) -> None:
        """Let the scene's later operations change the cloth as it is now, compile what its steps then need, and have
        everything as it was: the run does not wait for the compiler where their time comes. So may a body that another
        program moves take hold of it, with whichever vertex.

        An operation that would be refused now is left for its time.
        """
        scene = self.loaded.scene
        names = [spec.name for spec in scene.objects]
        for applied, chosen in zip(scene.operations, self.loaded.operations, strict=True):
            if round(float(applied.at) * scene.frame_rate) <= self.frame:
                continue
            trial = copy(self)
            with contextlib.suppress(BadInput):
                trial._alter(names.index(applied.object or names[0]), chosen)
                trial.measure(self.poses)
        if self.loaded.live and (free := np.flatnonzero(~self.parts()[0].pinned)).size:
            trial = copy(self)
            with contextlib.suppress(BadInput):
                trial.add(f"attach: {{body: {json.dumps(self.loaded.live[0])}, vertices: [{free[0]}]}}")
                trial.measure(self.poses)

    def parts(self) -> list[Fabric]:
        """The fabric of each object as it is now."""
        if len(self.pieces) == 1:
            return [self.fabric]
        if self._fabrics is None:  # joined fabrics are copies: parts are kept only where one changes
            self._fabrics = build.build_fabrics(self.loaded, self.geometry, self.start_poses, self.rested)
        return self._fabrics

    def _alter(self, index: int, chosen: Chosen) -> None:
        """Let an operation change one object; all is as it was where it is refused. Raises BadInput."""
        piece, fabrics = self.pieces[index], list(self.parts())
        own = slice(piece.start, piece.stop)
        state = State(self.state.x[own].copy(), self.state.v[own].copy(), self.state.t)
        outcome = self._apply(chosen, fabrics[index], state)
        made = outcome.changed
        if made is None:
            raise BadInput("the operation changed nothing", value=chosen.name)
        fabrics[index] = made.fabric
        moved = np.where(made.source >= 0, made.source + piece.start, -1)
        source = np.concatenate([np.arange(piece.start), moved, np.arange(piece.stop, self.fabric.number)])
        x, v = (
            np.concatenate([old[: piece.start], new, old[piece.stop :]])
            for old, new in ((self.state.x, made.state.x), (self.state.v, made.state.v))
        )
        told = {"frame": self.frame, "t": self.t, "operation": chosen.name, "object": piece.name}
        changed = copy(self)
        changed.changes = [*self.changes, told | {"facts": dict(outcome.facts)}]
        changed.crests = [*self.crests, np.asarray(outcome.arrays.get("crests", np.zeros((5, 0))), np.int32)]
        try:
            changed._take(fabrics, State(x, v, self.state.t))
            if self.numbers is not None:
                changed.numbers = keep_numbers(self.numbers, source, changed.pieces)
                before = source[changed.numbers]
                source = np.where(before >= 0, invert(self.numbers)[before], -1)
            changed._prepare(self.memory.arrays, source.astype(np.int32))
        except BadInput as error:
            if error.field != "solver.dt":
                raise
            problem = "the changed cloth would make the present step unstable"
            remedy = "solver: {dt: auto}, a smaller dt, a line of fewer small triangles, or springs: paper"
            raise BadInput(problem, value=f"{self.dt:g} s", limit=error.limit, remedy=remedy) from None
        # A step never grows while a run goes on, and what was at rest is so no more.
        if self.steps > changed.steps:
            changed.steps, changed.dt = self.steps, self.dt
        changed.stillness.begin(changed.state.x)
        changed.balanced = False
        changed.changes[-1]["measured"] = [changed.heights(len(changed.changes) - 1)]
        self.become(changed)

    def _apply(self, chosen: Chosen, fabric: Fabric, state: State) -> Outcome:
        """What an operation makes of one object, beside the body that it is made with. Raises BadInput."""
        if not hasattr(chosen.plugin, "apply_beside"):
            made: Outcome = chosen.plugin.apply(chosen.config, fabric, state, None)
            return made
        name, known = chosen.plugin.body(chosen.config), [body.name for body in self.loaded.scene.bodies]
        if name not in known or self.geometry is None or self.poses is None:
            remedy = nearest(name, known) if known else "give the scene the body"
            raise BadInput("there is no such body", field="body", value=name, remedy=remedy)
        held: Outcome = chosen.plugin.apply_beside(
            chosen.config, fabric, state, beside(state.x, self.geometry, self.poses, name)
        )
        return held

    def become(self, changed: Self) -> None:
        """Go on as a copy of this that something has been changed in: what is refused has then changed nothing here."""
        vars(self).update(vars(changed))

    def heights(self, number: int) -> dict[str, float]:
        """Mean height of what a change raised over the chord across it, along the normal to chord and line, and length
        of that chord [m]; empty for none. Both follow the cloth wherever it goes.
        """
        crest = self.crests[number]
        if not crest.size:
            return {}
        start = next(piece.start for piece in self.pieces if piece.name == self.changes[number]["object"])
        top, one, other, before, after = self.state.x[start + crest]
        normal = np.cross(other - one, after - before)
        height = np.abs(np.einsum("ck,ck->c", top - one, normal)) / np.linalg.norm(normal, axis=1)
        return {"height": float(height.mean()), "width": float(np.linalg.norm(other - one, axis=1).mean())}

    def wrinkles(self) -> dict[str, float]:
        """`heights` of all changes, as 0_height, 0_width and so on."""
        each = ((i, self.heights(i)) for i in range(len(self.changes)))
        return {f"{i}_{name}": value for i, found in each for name, value in found.items()}

    def _take(self, fabrics: list[Fabric], state: State) -> None:
        """Have these objects, where `state` says."""
        self._fabrics = fabrics if len(fabrics) > 1 else None
        self.fabric = join_fabrics(fabrics, self.loaded.scene.name)
        self.pieces = build.place_pieces(self.loaded, fabrics)
        self.state = state

    def altered(self) -> tuple[dict[str, NDArray[Any]], dict[str, Any]]:
        """Arrays and text for a checkpoint: the objects that operations have changed, and the order of the steps."""
        names = [piece.name for piece in self.pieces]
        changed = sorted({names.index(change["object"]) for change in self.changes})
        fabrics = self.parts() if changed else []
        arrays = {f"fabric/{i}/{name}": a for i in changed for name, a in fabric_arrays(fabrics[i]).items()}
        arrays |= {f"fabric/crests/{i}": crest for i, crest in enumerate(self.crests)}
        if self.numbers is not None:
            arrays[NUMBERS] = self.numbers
        origins = {str(i): dict(fabrics[i].origin) for i in changed}
        bound = {str(i): frames_bound(fabrics[i]) for i in changed}
        return arrays, {"changes": self.changes, "applied": self.applied, "origins": origins, "bound": bound}

    def adopt(self, point: Checkpoint) -> None:
        """Have the objects, and the step, of a checkpoint that `altered` was written to. Raises BadInput."""
        with fitting(self.loaded):
            own = (name for name in point.arrays if name == NUMBERS or name.startswith("fabric/"))
            another = self._adopt({name: point.arrays[name].copy() for name in own}, deepcopy(point.text))
        if another:
            self._prepare({})
            self.steps, self.dt = int(point.text["steps"]), float(point.text["dt"])

    def _adopt(self, arrays: dict[str, NDArray[Any]], text: dict[str, Any]) -> bool:
        """Whether another fabric is stepped now. Raises ContractError or whatever else a broken checkpoint leads to."""
        origins: dict[str, dict[str, float]] = text.get("origins", {})
        # The solver's memory is in the order that the recording was stepped in, none where that had no other.
        before, self.numbers = self.numbers, arrays.get(NUMBERS)
        if origins:
            self._adopt_fabrics(arrays, text, origins)
        elif np.array_equal(cast(Any, before), cast(Any, self.numbers)):  # so is None to None
            return False
        if self.numbers is not None:
            check_array(NUMBERS, self.numbers, np.int32, (self.fabric.number,))
            if not np.array_equal(np.sort(self.numbers), np.arange(self.fabric.number)):
                raise ContractError(f"{NUMBERS} does not name each vertex once")
        return True

    def _adopt_fabrics(
        self, arrays: dict[str, NDArray[Any]], text: dict[str, Any], origins: dict[str, dict[str, float]]
    ) -> None:
        self.applied = int(text["applied"])
        fabrics = list(self.parts())
        for number, origin in origins.items():
            own = {n.split("/", 2)[2]: a for n, a in arrays.items() if n.startswith(f"fabric/{number}/")}
            bound = text.get("bound", {}).get(number, frames_bound(fabrics[int(number)]))
            fabrics[int(number)] = fabric_from(own, fabrics[int(number)], origin, bound)
            from nuno.plugin_contract.results import check_fabric  # it knows all that plugins give, dye too

            check_fabric(fabrics[int(number)])
        sizes = {piece.name: fabric.number for piece, fabric in zip(self.pieces, fabrics, strict=True)}
        self.changes = list(text["changes"])
        self.crests = [arrays[f"fabric/crests/{i}"] for i in range(len(self.changes))]
        for i, (change, crest) in enumerate(zip(self.changes, self.crests, strict=True)):
            check_array(f"fabric/crests/{i}", crest, np.int32, (5, None), Bounds(0, sizes[change["object"]] - 1))
        self._take(fabrics, build.start_state(join_fabrics(fabrics, self.loaded.scene.name)))
