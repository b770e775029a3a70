"""Cloth that is dyed: two layers of cells, what they hold, how dye passes between them, and plugins for it.

Arrays are (2, ny, nx): layer 0 is the weft, whose yarns run along x (the last axis), layer 1 the warp, along y.
Amounts are fractions of what a cell can hold at most (`v_max`), per cell.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Annotated, Any, Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from nuno_schemas.dye_picture import Layers
from nuno_schemas.dyeing import WeiszZollinger
from nuno_schemas.fabric import Bool, Float, Memory
from nuno_schemas.layout import Bounds
from nuno_schemas.plugin import Files, Plugin


@dataclass(frozen=True)
class Tortuosity:
    """How straight the way from a cell to its neighbour is, in [0, 1]; 0 lets nothing pass (dye paper, figure 4).

    layers  to the other layer (I)
    beside  in a layer, across the yarn (II)
    rim     between fibre and gap (III)
    gap     between gap and gap (IV)
    yarn    in a layer, along the yarn (V)
    weave   additional, in a layer, between fibre above and fibre below (tau 2)
    """

    layers: Annotated[float, Bounds(0.0)]
    beside: Annotated[float, Bounds(0.0)]
    rim: Annotated[float, Bounds(0.0)]
    gap: Annotated[float, Bounds(0.0)]
    yarn: Annotated[float, Bounds(0.0)]
    weave: Annotated[float, Bounds(0.0)]


@dataclass(frozen=True)
class Cells(Layers):
    """A woven cloth as diffusion cells: its layers, and how dye spreads in them.

    porosity  (2, ny, nx)        P, share of a cell that is not fibre, in [0, 1]
    twist     (2, ny, nx)        tau 1 of the yarn, in [0, 1]
    resist    (2, ny, nx)        B, share of the room for mobile dye that paste or binding takes, in [0, 1]
    size      [m]                side of a cell
    coarser                      how many times as large cells are as those that D_ab is given for
    """

    porosity: Annotated[Float, 2, "ny", "nx", Bounds(0.0, 1.0)]
    twist: Annotated[Float, 2, "ny", "nx", Bounds(0.0, 1.0)]
    resist: Annotated[Float, 2, "ny", "nx", Bounds(0.0, 1.0)]
    size: Annotated[float, Bounds(above=0.0)]
    tortuosity: Tortuosity
    coarser: Annotated[int, Bounds(1)] = field(default=1, kw_only=True)

    @property
    def mobile_room(self) -> Float:
        """(2, ny, nx) V_u = V_max P (1 - B), capacity for mobile dye (dye paper, equation 9)."""
        room: Float = self.v_max * self.porosity * (1.0 - self.resist)
        return room

    @property
    def fixed_room(self) -> Float:
        """(2, ny, nx) V_d = (1 - P) V_max, capacity for fixed dye (equation 6); fibre alone holds any."""
        room: Float = (1.0 - self.porosity) * self.v_max * self.fibre
        return room


@dataclass(frozen=True)
class Isotherm:
    """How much dye fibre may fix, A_d, at the mobile amount phi beside it (dye paper, equations 5 to 8).

    A `kind` that the kernels know has its numbers in `first` and `second`:

        "partition"   k phi                     first k
        "freundlich"  k phi^b                   first k, second b
        "langmuir"    V_d K phi / (1 + K phi)   first K

    Any other has kind "python" and a `function(phi, room)` of arrays (2, ny, nx), room being V_d; it is
    called at every step.
    """

    kind: str
    first: Annotated[float, Bounds(0.0)] = 0.0
    second: Annotated[float, Bounds(0.0)] = 0.0
    function: Callable[[Float, Float], Float] | None = None


@dataclass(frozen=True)
class Dye:
    """One dye: D0 [m^2/s], its diffusion coefficient in water, and how fibre fixes it.

    `adsorption` is D_ab / D0; where it is 0, or without an isotherm, nothing is fixed. Without `weisz_zollinger`
    D = D0 P T; a solver that does not know it refuses it.
    """

    name: str
    D0: float
    adsorption: float = 0.0
    isotherm: Isotherm | None = None
    weisz_zollinger: WeiszZollinger | None = None

    @property
    def steepest(self) -> float:
        """The most that D comes to, over D0 P T."""
        return 1.0 if self.weisz_zollinger is None else self.weisz_zollinger.cap


@dataclass(frozen=True)
class DyeSystem:
    """A cloth and the dyes in it, each an amount by itself; `threads` is the most that kernels may use.

    `supply` (dyes, 2, ny, nx) is what supplies keep up: the least mobile dye that a cell holds after every step, 0
    where none does; None where nothing is kept up. It only ever adds: a cell that holds more is left alone, and one
    with less room is kept full. Solvers may keep what they made of arrays in here: give others, do not change them.
    `leave` is as nuno_schemas.system.System has it.
    """

    cells: Cells
    dyes: tuple[Dye, ...]
    threads: int = 1
    supply: Float | None = None
    leave: NDArray[np.int64] = field(default_factory=lambda: np.zeros(1, np.int64), compare=False)


@dataclass
class DyeState:
    """Amounts at time t [s], (dyes, 2, ny, nx): phi is mobile, fixed has been taken by fibre."""

    phi: Annotated[Float, "dyes", 2, "ny", "nx"]
    fixed: Annotated[Float, "dyes", 2, "ny", "nx"]
    t: float = 0.0


@dataclass(frozen=True)
class DyeReport:
    """What a solver did in a frame; mobile and fixed are the dyes' totals at its end, summed with compensation.

    `supplied` are the totals that kept-up supplies gave in this frame; empty stands for nothing.
    """

    status: Literal["ok", "diverged", "unconverged", "left"]
    steps: Annotated[int, Bounds(0)]
    mobile: Annotated[tuple[float, ...], "dyes"]
    fixed: Annotated[tuple[float, ...], "dyes"]
    message: str = ""
    totals: Mapping[str, int] = field(default_factory=dict)
    """What adds up over a run."""
    supplied: tuple[float, ...] = ()


@dataclass(frozen=True)
class Supply:
    """Dye that is given to a part of the cloth, once, or kept up for a time; or that is rinsed out of it.

    kind    what a report calls it
    dye     its place among the dyes; None, of what is rinsed out: all of them
    cells   (2, ny, nx) bool, what it reaches
    amount  share of V_u that cells are raised to; of a finite bath, the share that it holds before it is used
    start   [s] when it is given or begins to be kept up
    stop    [s] until when it is kept up, inf to the end; None: given once
    liquor  a finite bath's volume over the room of the cells it reaches; None: endless
    rinsed  share of their mobile dye that cells lose at `start`; None: they are given some
    """

    kind: str
    dye: Annotated[int, Bounds(0, below="dyes")] | None
    cells: Annotated[Bool, 2, "ny", "nx"]
    amount: Annotated[float, Bounds(0.0)]
    start: Annotated[float, Bounds(0.0)] = 0.0
    stop: float | None = None
    liquor: float | None = None
    rinsed: Annotated[float, Bounds(0.0, 1.0)] | None = None


class IsothermPlugin(Plugin, Protocol):
    """An isotherm by name."""

    def prepare(self, config: Any) -> Isotherm: ...


class DyeCloth(Plugin, Protocol):
    """Builds a cloth's cells, what they hold at the start, and what gives dye to them."""

    def build(self, config: Any, files: Files, seed: int, dyes: Sequence[str]) -> tuple[Cells, DyeState]:
        """Cells, and the amounts (dyes, 2, ny, nx) of `dyes`, by name, before any is supplied. Raises BadInput."""
        ...

    def resists(self, config: Any, cells: Cells, files: Files) -> tuple[Float, ...]:
        """B (ny, nx) of each of `config.resist`, all of them in the cells that were built. Raises BadInput."""
        ...

    def supplies(self, config: Any, cells: Cells, dyes: Sequence[str]) -> tuple[Supply, ...]:
        """What gives `dyes`, by name, to the cells that were built, in the order of `config.supply`.

        Raises BadInput.
        """
        ...

    def count(self, config: Any, files: Files) -> int:
        """Cells it will have, found without building it."""
        ...


class DyeSolverPlugin(Plugin, Protocol):
    """Advances the amounts of dye by whole steps over one frame."""

    def prepare(self, config: Any, system: DyeSystem, state: DyeState) -> Memory:
        """Memory for this system. Raises BadInput for what the solver cannot do."""
        ...

    def limit(self, config: Any, system: DyeSystem) -> float:
        """Largest stable step [s], inf where nothing limits it."""
        ...

    def advance(self, system: DyeSystem, state: DyeState, memory: Memory, steps: int, dt: float) -> DyeReport:
        """Advance `state` in place by `steps` steps of `dt` [s]; no steps at all only measure it."""
        ...

    def about(self, system: DyeSystem) -> str:
        """How its kernels run this system, in words for the report: threads, and why."""
        ...
