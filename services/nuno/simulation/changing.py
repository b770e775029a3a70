"""A simulation whose cloth is changed by operations while it runs."""

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

from nuno.collision.distance import body_distances
from nuno.plugin_contract.values import ContractError, check_array
from nuno.recording.recorded import Checkpoint
from nuno.runtime.stepper import Stepper, fitting
from nuno.scene.chosen_plugins import Chosen
from nuno.simulation.cloth import build
from nuno.simulation.cloth.join import join_fabrics
from nuno.simulation.cloth.numbering import find_numbers, invert, keep_numbers, takes_any_numbering
from nuno.simulation.operations import fabric_arrays, fabric_from, frames_bound, parse
from nuno.simulation.relax import Stillness
from nuno.simulation.renumbered_solver import RenumberedSolver
from nuno_schemas.bodies import Geometry, Poses
from nuno_schemas.errors import BadInput, nearest
from nuno_schemas.fabric import Fabric, Int, State
from nuno_schemas.layout import Bounds
from nuno_schemas.operation import Outcome, arranges
from nuno_schemas.plugin import Rested
from nuno_schemas.system import StepReport

NUMBERS = "numbers"
"""Name of the array `Changing.numbers` in a checkpoint."""


class Changing(Stepper):
    """Cloth with its state and its solver, which operations may change."""

    geometry: Geometry | None
    start_poses: Poses | None
    poses: Poses | None
    fabric: Fabric
    pieces: list[build.Piece]
    state: State
    numbers: Int | None
    """(n,) the vertex at each position of the stepped fabric, None where that keeps the user's order."""
    rested: Sequence[Rested]
    """Coarse state at rest of each object, empty where the scene has none."""
    stillness: Stillness
    balanced: bool

    @abstractmethod
    def measure(self, poses: Poses | None) -> StepReport:
        """Return energy and stretch of the present state, without a step; compiles the kernels of a step."""

    @abstractmethod
    def _prepare(self, arrays: dict[str, NDArray[Any]], source: Int | None = None) -> None:
        """Build system, step and memory from the scene; `arrays` is solver memory to keep, and `source` (n,) the former
        position of each vertex, in the order of the steps.
        """

    @property
    def solver(self) -> Chosen:
        """The scene's integrator; it takes states in the user's order."""
        chosen, numbers = self.loaded.integrator, self.numbers
        return chosen if numbers is None else replace(chosen, plugin=RenumberedSolver(chosen.plugin, numbers))

    def begin_unchanged(self) -> None:
        """Start with the cloth of the scene, before any operation."""
        self.numbers = find_numbers(self.fabric, self.pieces) if takes_any_numbering(self.loaded) else None
        self.changes: list[dict[str, Any]] = []
        """Changes by operations, in order: frame, t [s], operation, object and its facts."""
        self.applied = 0
        """Number of the scene's operations that have been applied."""
        self.crests: list[Int] = []
        """(5, c) for each change, the vertices of its object that measure its height: on the line, to the left and to
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
        """Apply an operation, `wrinkle: {...}`, at once; return the text that repeats it. Raises BadInput."""
        index, chosen, item = parse(item, self.loaded)
        self._alter(index, chosen)
        return item

    def due(self, frame: int) -> int:
        """Return the number of the scene's operations whose time is at most that of `frame`."""
        rate = self.loaded.scene.frame_rate
        return sum(round(float(applied.at) * rate) <= frame for applied in self.loaded.scene.operations)

    def alter_due(self) -> bool:
        """Apply the scene's operations that are due; return whether there were any. Raises BadInput."""
        scene, before = self.loaded.scene, self.applied
        order = sorted(range(len(scene.operations)), key=lambda i: float(scene.operations[i].at))
        names = [spec.name for spec in scene.objects]
        for i in order[before : self.due(self.frame)]:
            name = scene.operations[i].object or names[0]
            try:
                if not arranges(self.loaded.operations[i].plugin):  # an arrangement is built into the cloth
                    self._alter(names.index(name), self.loaded.operations[i])
            except BadInput as error:
                raise self.loaded.at(f"operations[{i}]", error) from None
            self.applied += 1
        return self.applied > before

    def rehearse(self) -> None:
        """Compile the kernels that later operations need, by applying each to a copy of the present cloth: the run does
        not wait for the compiler then. The same holds for an attachment to a body that another program moves.

        An operation that would be refused now is skipped.
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
        """Return the present fabric of each object."""
        if len(self.pieces) == 1:
            return [self.fabric]
        if self._fabrics is None:  # joined fabrics are copies: parts are kept only where one changes
            self._fabrics = build.build_fabrics(self.loaded, self.geometry, self.start_poses, self.rested)
        return self._fabrics

    def _alter(self, index: int, chosen: Chosen) -> None:
        """Apply an operation to one object; a refused one changes nothing. Raises BadInput."""
        piece, fabrics = self.pieces[index], list(self.parts())
        vertices = slice(piece.start, piece.stop)
        state = State(self.state.x[vertices].copy(), self.state.v[vertices].copy(), self.state.t)
        outcome = self._apply(chosen, fabrics[index], state)
        changed_cloth = outcome.changed
        if changed_cloth is None:
            raise BadInput("the operation changed nothing", value=chosen.name)
        fabrics[index] = changed_cloth.fabric
        moved = np.where(changed_cloth.source >= 0, changed_cloth.source + piece.start, -1)
        source = np.concatenate([np.arange(piece.start), moved, np.arange(piece.stop, self.fabric.number)])
        x, v = (
            np.concatenate([old[: piece.start], new, old[piece.stop :]])
            for old, new in ((self.state.x, changed_cloth.state.x), (self.state.v, changed_cloth.state.v))
        )
        change = {"frame": self.frame, "t": self.t, "operation": chosen.name, "object": piece.name}
        changed = copy(self)
        changed.changes = [*self.changes, change | {"facts": dict(outcome.facts)}]
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
        # A step never grows during a run, and changed cloth is no longer at rest.
        if self.steps > changed.steps:
            changed.steps, changed.dt = self.steps, self.dt
        changed.stillness.begin(changed.state.x)
        changed.balanced = False
        changed.changes[-1]["measured"] = [changed.heights(len(changed.changes) - 1)]
        self.become(changed)

    def _apply(self, chosen: Chosen, fabric: Fabric, state: State) -> Outcome:
        """Return the outcome of an operation on one object, and on the body that it names. Raises BadInput."""
        if not hasattr(chosen.plugin, "apply_beside"):
            outcome: Outcome = chosen.plugin.apply(chosen.config, fabric, state, None)
            return outcome
        name, bodies = chosen.plugin.body(chosen.config), [body.name for body in self.loaded.scene.bodies]
        if name not in bodies or self.geometry is None or self.poses is None:
            remedy = nearest(name, bodies) if bodies else "give the scene the body"
            raise BadInput("there is no such body", field="body", value=name, remedy=remedy)
        outcome_on_body: Outcome = chosen.plugin.apply_beside(
            chosen.config, fabric, state, body_distances(state.x, self.geometry, self.poses, name)
        )
        return outcome_on_body

    def become(self, changed: Self) -> None:
        """Take all attributes of a changed copy: a change that is refused has altered only the copy."""
        vars(self).update(vars(changed))

    def heights(self, number: int) -> dict[str, float]:
        """Return the mean height of a raised line over the chord across it, along the normal to chord and line, and the
        length of that chord [m]; empty for a change without crests. Both follow the moving cloth.
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
        """Return `heights` of all changes, as 0_height, 0_width and so on."""
        heights = ((i, self.heights(i)) for i in range(len(self.changes)))
        return {f"{i}_{name}": value for i, values in heights for name, value in values.items()}

    def _take(self, fabrics: list[Fabric], state: State) -> None:
        """Replace the objects by these fabrics, in `state`."""
        self._fabrics = fabrics if len(fabrics) > 1 else None
        self.fabric = join_fabrics(fabrics, self.loaded.scene.name)
        self.pieces = build.place_pieces(self.loaded, fabrics)
        self.state = state

    def altered(self) -> tuple[dict[str, NDArray[Any]], dict[str, Any]]:
        """Return arrays and text for a checkpoint: the changed objects, and the order of vertices in the steps."""
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
        """Take objects and step from a checkpoint that `altered` was written to. Raises BadInput."""
        with fitting(self.loaded):
            names = (name for name in point.arrays if name == NUMBERS or name.startswith("fabric/"))
            rebuilt = self._adopt({name: point.arrays[name].copy() for name in names}, deepcopy(point.text))
        if rebuilt:
            self._prepare({})
            self.steps, self.dt = int(point.text["steps"]), float(point.text["dt"])

    def _adopt(self, arrays: dict[str, NDArray[Any]], text: dict[str, Any]) -> bool:
        """Return whether the stepped fabric is another now. Any error may show a broken checkpoint."""
        origins: dict[str, dict[str, float]] = text.get("origins", {})
        # The solver's memory is in the order of the recording's steps, the user's where that has no numbers.
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
            fabric_values = {n.split("/", 2)[2]: a for n, a in arrays.items() if n.startswith(f"fabric/{number}/")}
            bound = text.get("bound", {}).get(number, frames_bound(fabrics[int(number)]))
            fabrics[int(number)] = fabric_from(fabric_values, fabrics[int(number)], origin, bound)
            from nuno.plugin_contract.results import check_fabric  # it imports the types of all plugins, dye's too

            check_fabric(fabrics[int(number)])
        sizes = {piece.name: fabric.number for piece, fabric in zip(self.pieces, fabrics, strict=True)}
        self.changes = list(text["changes"])
        self.crests = [arrays[f"fabric/crests/{i}"] for i in range(len(self.changes))]
        for i, (change, crest) in enumerate(zip(self.changes, self.crests, strict=True)):
            check_array(f"fabric/crests/{i}", crest, np.int32, (5, None), Bounds(0, sizes[change["object"]] - 1))
        self._take(fabrics, build.start_state(join_fabrics(fabrics, self.loaded.scene.name)))
