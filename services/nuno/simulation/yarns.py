"""A fabric's yarns and springs for output: lengths for the report, edges, tension and pressure for display."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nuno.plugin_contract import registry
from nuno.scene.scene_file import Loaded
from nuno_schemas.fabric import Fabric, Float, State
from nuno_schemas.operation import Outcome
from nuno_schemas.plugin import Landmarked
from nuno_schemas.vectors import vertex_areas

# Tension of links of yarns, for display.


def tension_arrays(fabric: Fabric) -> dict[str, NDArray[Any]]:
    """Return the arrays that the tension of the shown edges (e,) needs besides positions; empty for a fabric without
    yarns, or with springs that are not shown. Sides of a membrane's triangles have no tension.

    edge_k, edge_mu (e,) float32 [N/m, 1]; edge_beside (e, 2) int32 the links before and after on the same yarn, -1
    for none; yarns that lock also have edge_lock, edge_k_lock (e,) float32 [1, N/m].
    """
    springs, yarns = fabric.springs, fabric.yarns
    if springs is None or yarns is None:
        return {}
    shown = springs.of_kind(0)
    if shown.any() and not shown.all():
        return {}
    pairs, _ = yarns.neighbours()
    beside = np.full((springs.number, 2), -1, np.int32)
    beside[pairs[:, 0], 1], beside[pairs[:, 1], 0] = pairs[:, 1], pairs[:, 0]
    mu = np.zeros(springs.number, np.float32)
    mu[yarns.links] = np.repeat(yarns.mu, np.diff(yarns.ptr))
    out: dict[str, NDArray[Any]] = {"edge_mu": mu, "edge_beside": beside}
    for name, values in (("edge_k", springs.k), ("edge_lock", springs.lock), ("edge_k_lock", springs.k_lock)):
        if values is not None:
            out[name] = springs.per_spring(values).astype(np.float32)
    return {name: append_sides(fabric, values, -1 if name == "edge_beside" else 0.0) for name, values in out.items()}


@dataclass(frozen=True)
class Tensions:
    """The knit paper's tension of links, T'_n = T_n + mu (T_(n-1) + T_(n+1)), from their stretch.

    Arrays are those of `tension_arrays`, and rest (e,) float32 [m].
    """

    rest: NDArray[np.float32]
    k: NDArray[np.float32]
    mu: NDArray[np.float32]
    beside: NDArray[np.int32]
    lock: NDArray[np.float32] | None
    k_lock: NDArray[np.float32] | None

    @staticmethod
    def read(arrays: Mapping[str, NDArray[Any]], mine: NDArray[np.bool_]) -> Tensions | None:
        """Read the links `mine` (e,) of a fabric message; None if it has no tension of them, as for sides of a
        membrane's triangles.

        Raises ValueError where arrays do not fit.
        """
        if "edge_k" not in arrays:
            return None
        number, around = len(mine), arrays["edge_beside"]
        values_by_name = {name: arrays.get(f"edge_{name}") for name in ("rest", "k", "mu", "lock", "k_lock")}
        if any(values is not None and len(values) != number for values in values_by_name.values()):
            raise ValueError("the arrays of yarns' tension differ in length")
        if around.shape != (number, 2) or (around.size and not (around.min() >= -1 and around.max() < number)):
            raise ValueError("a link beside another that is not there")
        if not arrays["edge_k"][mine].any():
            return None
        # The last number is that of a missing neighbour, -1.
        numbers = np.append(np.where(mine, np.cumsum(mine) - 1, -1), -1).astype(np.int32)
        selected: Any = {name: None if values is None else values[mine] for name, values in values_by_name.items()}
        return Tensions(**selected, beside=numbers[around[mine]])

    def __call__(self, stretch: NDArray[np.floating]) -> Float:
        """Return tensions (e,) [N] at elongations (e,), |d| / rest - 1."""
        tension = np.zeros(len(self.rest) + 1)  # the last is a missing neighbour
        tension[:-1] = self.k * self.rest * stretch
        if self.lock is not None and self.k_lock is not None:
            tension[:-1] += (self.k_lock - self.k) * self.rest * np.maximum(stretch - self.lock, 0.0)
        return np.asarray(tension[:-1] + self.mu * (tension[self.beside[:, 0]] + tension[self.beside[:, 1]]))


# Pressure of knits on bodies, by the operation `pressure`, for reports, tables and pictures.

OPERATION = "pressure"


def has_pressure(fabric: Fabric) -> bool:
    """Return whether the fabric is a net of yarns with areas, as knits are."""
    return fabric.yarns is not None and fabric.cells is not None and len(fabric.cells) > 0


def named_heights(loaded: Loaded) -> dict[str, float]:
    """Return the heights [m] of named places on bodies at rest; if several bodies have a name, the first one counts."""
    heights: dict[str, float] = {}
    for collider, motion in zip(loaded.colliders, loaded.motions, strict=True):
        if motion is None and isinstance(collider.plugin, Landmarked):
            heights = {**collider.plugin.heights(collider.config), **heights}
    return heights


def find_pressure(loaded: Loaded, fabric: Fabric, x: Float) -> Outcome:
    """Apply the operation at x (n, 3) [m]: array `pressure` (n,) [Pa], and facts, also at `named_heights`."""
    operation = registry.load("nuno.operations", OPERATION)
    config = operation.Config.model_validate({"heights": named_heights(loaded)})
    outcome: Outcome = operation.apply(config, fabric, State(x, 0.0 * x), None)
    return outcome


def measure_yarns(fabric: Fabric) -> dict[str, dict[str, float]]:
    """Return rest lengths [m] by name of yarn: of all with that name, and of the longest, a course in a knit."""
    if fabric.yarns is None or fabric.springs is None:
        return {}
    lengths = fabric.yarns.lengths(fabric.springs)
    measures: dict[str, dict[str, float]] = {}
    for index, name in enumerate(fabric.yarns.names):
        selected = lengths[fabric.yarns.kind == index]
        measures[name] = {"length": float(selected.sum()), "longest": float(selected.max(initial=0.0))}
    return measures


def measure_courses(fabric: Fabric, x: Float) -> dict[str, Any]:
    """Return the length of each yarn of at least two links at x (n, 3) [m], as a ratio of its rest length.

    `min`, `mean` and `max`, with the numbers, from 0, of the shortest and the longest yarn; in a knit these are courses
    from the bottom. `rest` and `present` [m] hold all. Empty if there is no such yarn.
    """
    if fabric.yarns is None or fabric.springs is None:
        return {}
    several = np.diff(fabric.yarns.ptr) > 1
    if not several.any() or not np.isfinite(x).all():
        return {}
    pairs = fabric.springs.pairs()
    now = np.linalg.norm(x[pairs[:, 1]] - x[pairs[:, 0]], axis=1)
    rest, present = (fabric.yarns.lengths(fabric.springs, each)[several] for each in (None, now))
    ratio = present / rest
    return {
        "min": float(ratio.min()),
        "mean": float(present.sum() / rest.sum()),
        "max": float(ratio.max()),
        "shortest": int(ratio.argmin()),
        "longest": int(ratio.argmax()),
        "rest": rest.tolist(),
        "present": present.tolist(),
    }


def edge_yarns(fabric: Fabric) -> NDArray[np.int8] | None:
    """Return the index (e,) of the yarn's name of each of `structural_edges`, -1 for none; None without yarns."""
    springs, yarns = fabric.springs, fabric.yarns
    if springs is None or yarns is None:
        return None
    kind = np.full(springs.number, -1, np.int8)
    kind[yarns.links] = np.repeat(yarns.kind, np.diff(yarns.ptr))
    structural = springs.of_kind(0)
    return append_sides(fabric, kind[structural] if structural.any() else kind, -1)


def structural_edges(fabric: Fabric) -> tuple[np.ndarray, Float]:
    """Return pairs and rest lengths of the structural springs (all springs if none is structural), and of the sides of
    a membrane's triangles, for display.
    """
    springs, membrane = fabric.springs, fabric.membrane
    pairs, rest = np.zeros((0, 2), np.int32), np.zeros(0)
    if springs is not None:
        shown = springs.of_kind(0)
        if membrane is None and not shown.any():
            shown[:] = True
        pairs, rest = springs.pairs()[shown], springs.per_spring(springs.rest)[shown]
    if membrane is not None:
        sides, long = membrane.edges()
        pairs, rest = np.concatenate([pairs, sides]), np.append(rest, long)
    return pairs, rest


SPREAD = 0.99
"""Share of the area whose stretch is reported: the largest stretch at a pinned point grows with a mesh's fineness."""


def measure_stretch(fabric: Fabric, x: Float) -> dict[str, Any]:
    """Return the stretch of SPREAD of the area (of a net, its vertices) at x (n, 3) [m]: all but the rest is below it;
    and the largest, with its vertex and place [m]. Empty without springs and membrane.

    A vertex has the stretch |d| / rest - 1 of its most stretched structural spring, or side of a triangle.
    """
    pairs, rest = structural_edges(fabric)
    if not (rest > 0.0).any() or not np.isfinite(x).all():
        return {}
    pairs, rest = pairs[rest > 0.0], rest[rest > 0.0]
    faces = fabric.faces
    weight = vertex_areas(x, faces) if len(faces) else np.bincount(pairs[:, 0], minlength=len(x))
    with np.errstate(over="ignore", invalid="ignore"):
        elongation = np.linalg.norm(x[pairs[:, 1]] - x[pairs[:, 0]], axis=1) / rest - 1.0
    stretch = np.full(len(x), -1.0)
    for end in pairs.T:
        np.maximum.at(stretch, end, elongation)
    if not np.isfinite(stretch).all():  # positions beyond what a square can have
        return {}
    order, most = np.argsort(stretch), int(stretch.argmax())
    below = np.searchsorted(np.cumsum(weight[order]), SPREAD * weight.sum())
    return {"area": SPREAD, "below": float(stretch[order[below]]), "most": float(stretch[most]), "vertex": most,
            "place": x[most].tolist()}  # fmt: skip


def append_sides(fabric: Fabric, values: NDArray[Any], fill: float) -> NDArray[Any]:
    """Append `fill` for sides of a membrane's triangles to values (s, ...) of springs, as in `structural_edges`."""
    if fabric.membrane is None:
        return values
    more = np.full((len(fabric.membrane.edges()[0]), *values.shape[1:]), fill, values.dtype)
    return np.concatenate([values, more])
