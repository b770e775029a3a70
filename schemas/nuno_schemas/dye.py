"""Dyed cloth: two layers of cells, the dye in them, diffusion between them, and the plugins of dyeing.

Arrays are (2, ny, nx): layer 0 is the weft, whose yarns run along x (the last axis), layer 1 the warp, along y.
Amounts are per cell, as fractions of the most that a cell can hold (`v_max`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Annotated, Any, Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from nuno_schemas.dyeing import WeiszZollinger
from nuno_schemas.fabric import Bool, Float, Memory
from nuno_schemas.layout import Bounds
from nuno_schemas.pictures import Layers
from nuno_schemas.plugin import Files, Plugin


@dataclass(frozen=True)
class Tortuosity:
    """Straightness of the path from a cell to its neighbour, in [0, 1]; 0 blocks all dye (dye paper, figure 4).

    layers  to the other layer (I)
    beside  within a layer, across the yarn (II)
    rim     between fibre and gap (III)
    gap     between gap and gap (IV)
    yarn    within a layer, along the yarn (V)
    weave   additional factor within a layer, between fibre above and fibre below (tau 2)
    """

    layers: Annotated[float, Bounds(0.0)]
    beside: Annotated[float, Bounds(0.0)]
    rim: Annotated[float, Bounds(0.0)]
    gap: Annotated[float, Bounds(0.0)]
    yarn: Annotated[float, Bounds(0.0)]
    weave: Annotated[float, Bounds(0.0)]


@dataclass(frozen=True)
class Cells(Layers):
    """A woven cloth as diffusion cells: its layers, and the properties that govern diffusion.

    porosity  (2, ny, nx)        P, share of a cell that is not fibre, in [0, 1]
    twist     (2, ny, nx)        tau 1 of the yarn, in [0, 1]
    resist    (2, ny, nx)        B, share of the capacity for mobile dye that paste or binding takes, in [0, 1]
    size      [m]                side of a cell
    coarser                      size of a cell over that of the cells for which D_ab is given
    """

    porosity: Annotated[Float, 2, "ny", "nx", Bounds(0.0, 1.0)]
    twist: Annotated[Float, 2, "ny", "nx", Bounds(0.0, 1.0)]
    resist: Annotated[Float, 2, "ny", "nx", Bounds(0.0, 1.0)]
    size: Annotated[float, Bounds(above=0.0)]
    tortuosity: Tortuosity
    coarser: Annotated[int, Bounds(1)] = field(default=1, kw_only=True)

    @property
    def mobile_room(self) -> Float:
        """V_u = V_max P (1 - B), capacity for mobile dye (dye paper, equation 9), shape (2, ny, nx)."""
        return np.asarray(self.v_max * self.porosity * (1.0 - self.resist))

    @property
    def fixed_room(self) -> Float:
        """V_d = (1 - P) V_max, capacity for fixed dye (equation 6), 0 outside fibre, shape (2, ny, nx)."""
        return np.asarray((1.0 - self.porosity) * self.v_max * self.fibre)


@dataclass(frozen=True)
class Isotherm:
    """The most dye that fibre fixes, A_d, at the mobile amount phi in its cell (dye paper, equations 5 to 8).

    The kinds compiled into the kernels have their parameters in `first` and `second`:

        "partition"   k phi                     first k
        "freundlich"  k phi^b                   first k, second b
        "langmuir"    V_d K phi / (1 + K phi)   first K

    Any other isotherm, of a kind of its own, has a `law`: a named tuple of numbers with a compiled method
    limit(phi, room), room being V_d, which solvers compile into their kernels (nuno_kernels.formula).
    """

    kind: str
    first: Annotated[float, Bounds(0.0)] = 0.0
    second: Annotated[float, Bounds(0.0)] = 0.0
    law: Any = None


@dataclass(frozen=True)
class Dye:
    """One dye: D0 [m^2/s], its diffusion coefficient in water, and its adsorption by fibre.

    `adsorption` is D_ab / D0; if it is 0, or without an isotherm, nothing is fixed. `uptake` is driven by the
    difference phi - A of mobile and fixed dye, or by the amount phi, until A is at its limit. Without `weisz_zollinger`
    D = D0 P T; a solver that does not support it refuses it.
    """

    name: str
    D0: float
    adsorption: float = 0.0
    isotherm: Isotherm | None = None
    weisz_zollinger: WeiszZollinger | None = None
    uptake: Literal["difference", "amount"] = "difference"

    @property
    def steepest(self) -> float:
        """Largest possible D over D0 P T."""
        return 1.0 if self.weisz_zollinger is None else self.weisz_zollinger.cap


@dataclass(frozen=True)
class DyeSystem:
    """A cloth and its independent dyes; `threads` is the most that kernels may use.

    `supply` (dyes, 2, ny, nx) is the least mobile dye that a cell holds after every step, maintained by supplies, 0
    without a supply; None if there are no supplies. It only adds dye: a cell that holds more is unchanged, and a cell
    with less capacity is kept full. Solvers may cache data made from these arrays: replace arrays, never modify them.
    `leave` is that of nuno_schemas.system.System.
    """

    cells: Cells
    dyes: tuple[Dye, ...]
    threads: int = 1
    supply: Float | None = None
    leave: NDArray[np.int64] = field(default_factory=lambda: np.zeros(1, np.int64), compare=False)


@dataclass
class DyeState:
    """Amounts at time t [s], (dyes, 2, ny, nx): mobile dye phi, and dye fixed by fibre."""

    phi: Annotated[Float, "dyes", 2, "ny", "nx"]
    fixed: Annotated[Float, "dyes", 2, "ny", "nx"]
    t: float = 0.0


@dataclass(frozen=True)
class DyeReport:
    """A solver's report of a frame; mobile and fixed are the dyes' totals at its end, summed with compensation.

    `supplied` is the total per dye that continuous supplies added in this frame; empty means none.
    """

    status: Literal["ok", "diverged", "unconverged", "left"]
    steps: Annotated[int, Bounds(0)]
    mobile: Annotated[tuple[float, ...], "dyes"]
    fixed: Annotated[tuple[float, ...], "dyes"]
    message: str = ""
    totals: Mapping[str, int] = field(default_factory=dict)
    """Counts that add up over a run."""
    supplied: tuple[float, ...] = ()


@dataclass(frozen=True)
class Supply:
    """Dye supplied to a part of the cloth, once or continuously for a time; or a rinse that removes dye.

    kind    name in reports
    dye     index of the dye; None, for a rinse: all dyes
    cells   (2, ny, nx) bool, cells that it reaches
    amount  share of V_u that cells are raised to; of a finite bath, its share before use
    start   [s] time of a single supply, or start of a continuous one
    stop    [s] end of a continuous supply, inf for the end of the run; None: supplied once
    liquor  volume of a finite bath over the capacity of the cells it reaches; None: infinite
    rinsed  share of their mobile dye that cells lose at `start`; None: not a rinse
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
    """Provides an isotherm by name."""

    def prepare(self, config: Any) -> Isotherm:
        """Return the isotherm of a configuration. Its limit is 0 without dye, and never falls as mobile dye grows."""
        ...


class DyeCloth(Plugin, Protocol):
    """Builds a cloth's cells, their initial amounts of dye, and the supplies of dye."""

    def build(self, config: Any, files: Files, seed: int, dyes: Sequence[str]) -> tuple[Cells, DyeState]:
        """Build the cells, and the amounts (dyes, 2, ny, nx) of the dyes named in `dyes`, before any supply. Raises
        BadInput.
        """
        ...

    def resists(self, config: Any, cells: Cells, files: Files) -> tuple[Float, ...]:
        """Return B (ny, nx) of each of `config.resist`, in the cells that were built. Raises BadInput."""
        ...

    def supplies(self, config: Any, cells: Cells, dyes: Sequence[str]) -> tuple[Supply, ...]:
        """Return the supplies of the dyes named in `dyes` to the cells that were built, in the order of
        `config.supply`. Raises BadInput.
        """
        ...

    def count(self, config: Any, files: Files) -> int:
        """Return the number of cells of the cloth, without building it."""
        ...


class DyeSolverPlugin(Plugin, Protocol):
    """Advances the amounts of dye by whole steps over one frame."""

    def prepare(self, config: Any, system: DyeSystem, state: DyeState) -> Memory:
        """Return memory for this system. Raises BadInput for a system that the solver does not support."""
        ...

    def limit(self, config: Any, system: DyeSystem) -> float:
        """Return the largest stable step [s], inf without a limit."""
        ...

    def advance(self, system: DyeSystem, state: DyeState, memory: Memory, steps: int, dt: float) -> DyeReport:
        """Advance `state` in place by `steps` steps of `dt` [s]; with `steps` = 0 only measure it."""
        ...

    def about(self, system: DyeSystem) -> str:
        """Describe for the report how the kernels run this system: the number of threads, and why."""
        ...
