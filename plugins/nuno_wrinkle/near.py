"""The springs and triangles near a line, and the rules for its new springs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import BENDING, STRUCTURAL, Fabric, Float, Int
from nuno_wrinkle.edges import Edges, area_of, edges_of, keys_of, pairs_of
from nuno_wrinkle.raised import Region

Rule = Literal["paper", "physical"]
ON_SPRINGS = "draw on a mesh or a shirt of tension: springs, or on a sheet or skirt of cells: triangles"


def describe(fabric: Fabric) -> dict[str, float]:
    """Return the parameters of a model as built, also for later lines: r_avg [m], k_std [N/m], density [kg/m^2], the
    damping ratio of springs, and r_bend, k_bend of bending springs. Raises BadInput for a model without structural
    springs.

    A mesh without inner edges has no bending springs: k_bend is then that of `fabric.origin`, and r_bend is sqrt(3)
    r_avg, the distance of the far corners of two equilateral triangles of side r_avg.
    """
    springs = fabric.springs
    if springs is None or not springs.of_kind(STRUCTURAL).any():
        problem = "the cloth has no structural springs, and so neither k_std nor r_avg"
        raise BadInput(problem, field="k_std", remedy=ON_SPRINGS)
    pairs, k, rest, c = springs.pairs(), *(springs.per_spring(a) for a in (springs.k, springs.rest, springs.c))
    one, other = fabric.mass[pairs[:, 0]], fabric.mass[pairs[:, 1]]
    critical = 2.0 * np.sqrt(k * one * other / (one + other))
    structural, bent = springs.of_kind(STRUCTURAL), springs.of_kind(BENDING)
    damped = structural & (critical > 0.0)  # on elongated triangles a measured fabric has springs of stiffness 0
    r_avg = float(rest[structural].mean())
    return {
        "r_avg": r_avg,
        "k_std": float(k[structural].mean()),
        "density": float(fabric.mass.sum()) / area_of(fabric.position, fabric.faces),
        "damping_ratio": float((c[damped] / critical[damped]).mean()),
        "r_bend": float(rest[bent].mean()) if bent.any() else float(np.sqrt(3.0)) * r_avg,
        "k_bend": float(k[bent].mean()) if bent.any() else fabric.origin.get("k_bend", 0.0),
    }


@dataclass(frozen=True)
class Near:
    """Springs and triangles of a region: `edges` of its triangles, their rest lengths (e,), the springs (e,)
    on them, and the mean stretch (f,) of each triangle of the whole mesh, 1 outside of the region.
    """

    edges: Edges
    rest: Float
    spring: NDArray[np.int64]
    stretch: Float


def find_sprung(fabric: Fabric) -> NDArray[np.bool_]:
    """Return whether triangles (f,) have structural springs along all their edges."""
    springs, edges = fabric.springs, edges_of(fabric.faces)
    assert springs is not None
    pairs = springs.pairs()[springs.of_kind(STRUCTURAL)]
    return np.asarray(np.isin(edges.key, keys_of(pairs))[edges.of_face].all(axis=1))


def find_near(fabric: Fabric, x: Float, region: Region) -> Near:
    """Return the region's springs and triangles. Raises BadInput if edges lack springs, as on a grid of quads."""
    springs = fabric.springs
    assert springs is not None
    edges = edges_of(fabric.faces[region.face])
    pairs = springs.pairs()
    inside = np.zeros(fabric.number, np.bool_)
    inside[fabric.faces[region.face]] = True
    selected = inside[pairs[:, 0]] & inside[pairs[:, 1]] & springs.of_kind(STRUCTURAL)
    chosen = np.flatnonzero(selected)
    key = keys_of(pairs[chosen])
    order = np.argsort(key, kind="stable")
    place, present = Edges(key[order], np.zeros((0, 3), np.int64)).rows(edges.key)
    ends = pairs_of(edges.key)
    if not present.all():
        raise BadInput(
            "the cloth has no spring along an edge of its triangles", field="lines",
            value=ends[~present][0].tolist(), limit="springs on all edges, as the wrinkle paper has them",
            remedy=ON_SPRINGS,
        )  # fmt: skip
    length = np.linalg.norm(x[ends[:, 1]] - x[ends[:, 0]], axis=1)
    spring = chosen[order][place]
    rest = springs.per_spring(springs.rest)[spring]
    stretch = np.ones(len(fabric.faces))
    stretch[region.face] = (length / rest)[edges.of_face].mean(axis=1)
    return Near(edges, rest, spring, stretch)


def stiffness_of(rest: Float, k_std: float, r_avg: float, rule: Rule) -> Float:
    return np.asarray(k_std * (rest / r_avg if rule == "paper" else r_avg / rest))


def damping_of(k: Float, pairs: Int, mass: Float, ratio: float) -> Float:
    m = mass[pairs]
    return np.asarray(2.0 * ratio * np.sqrt(k * m[:, 0] * m[:, 1] / m.sum(axis=1)))
