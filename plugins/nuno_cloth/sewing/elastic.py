"""Elastics: bands sewn along edges that go round the body. They are shorter than it and hold a garment in place.

A skirt's waist that is cut as wide as the body's slides off: knitted cloth gives, and nothing presses it on. A band
that is stretched by a strain e pulls with T = EA e, presses on a body of radius r with T / r per length, and so with 2
pi T all round, whatever r is; with friction mu it bears a weight of 2 pi mu T. Its mass is added to the cloth's: waves
run along it at sqrt(EA / DENSITY) = 32 m/s, no faster than along most fabrics, and steps stay as long.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from unicodedata import normalize

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import ConvexHull

from nuno_cloth.fabrics.presets import DAMPING_RATIO
from nuno_cloth.models.triangles import Edges
from nuno_cloth.sewing.sew import Sewn
from nuno_geometry.sections import cut_mesh
from nuno_schemas.errors import BadInput, nearest
from nuno_schemas.fabric import ELASTIC, Float, Int, Springs

STIFFNESS, DENSITY = 15.0, 0.015
"""EA [N] and mass per relaxed length [kg/m] of a knitted band some 2 cm wide: assumed."""
FLATTEST = 1e-3
"""Points nearer to a line than this [m] enclose nothing."""


@dataclass(frozen=True)
class Band:
    """An elastic band: pairs (k, 2) of sewn vertices that go round, and the relaxed length (k,) of each part [m]."""

    pairs: Int
    rest: Float


def bands_along(
    label: str, share: float, sewn: Sewn, edges: Edges, x: Float, body: Float, body_faces: Int
) -> list[Band]:
    """Return bands along the edges of a label, one for each closed line that these form on the garment at its start x
    (n, 3) [m], each as long as this share of the body's girth, but no longer than the edges are cut.

    A seam's length is that of its shorter edge. Raises BadInput for a label without edges, and for edges that enclose
    nothing.
    """
    cut = np.full(len(edges.pairs), np.inf)
    np.minimum.at(cut, edges.of_face.reshape(-1), sewn.sides.reshape(-1))
    bands = []
    for sides in _lines(label, sewn, edges):
        pairs = edges.pairs[sides]
        girth = girth_inside(x[np.unique(pairs)], body, body_faces)
        if not girth:
            remedy = "an elastic goes along edges that go round the body, or round a limb"
            raise BadInput("edges of this label go round no part of the body", value=label, remedy=remedy)
        bands.append(Band(pairs, min(1.0, share * girth / float(cut[sides].sum())) * cut[sides]))
    return bands


def _lines(label: str, sewn: Sewn, edges: Edges) -> list[Int]:
    """Return the numbers of sides of each closed line along the edges of a label. Raises BadInput."""
    label = normalize("NFC", label)
    runs = [run for on_label, names in zip(sewn.edges, sewn.labels, strict=True)
            for run, name in zip(on_label, names, strict=True) if normalize("NFC", name or "") == label]  # fmt: skip
    if not runs:
        labels = sorted({name for names in sewn.labels for name in names if name is not None})
        raise BadInput("no edge of the pattern has this label", value=label, remedy=nearest(label, labels))
    n, code = sewn.number, np.array([sewn.number, 1])
    ends = np.sort(np.concatenate([sewn.merged[np.stack([run[:-1], run[1:]], axis=1)] for run in runs]), axis=1)
    on_label = np.flatnonzero(np.isin(edges.pairs @ code, ends @ code))
    a, b = edges.pairs[on_label].T
    if (np.bincount(np.concatenate([a, b]))[np.unique(np.concatenate([a, b]))] != 2).any():
        remedy = "give all edges of one opening, or of a seam round the body, the same label"
        raise BadInput("edges of this label do not go round", value=label, remedy=remedy)
    component = connected_components(coo_array((np.ones(len(on_label)), (a, b)), shape=(n, n)), directed=False)[1][a]
    return [on_label[component == part] for part in np.unique(component)]


def girth_inside(ring: Float, x: Float, faces: Int) -> float:
    """Return the girth [m] of the parts of a body x (v, 3), faces (f, 3), inside of a ring of points (k, 3), in the
    mean plane of these; 0 if it encloses nothing.
    """
    middle = ring.mean(axis=0)
    axes = np.linalg.svd(ring - middle, full_matrices=False)[2]
    flat = (ring - middle) @ axes[:2].T
    if np.ptp(flat, axis=0).min() < FLATTEST:
        return 0.0
    sides = ConvexHull(flat).equations
    inner = [
        (loop.points - middle) @ axes[:2].T
        for loop in cut_mesh(x, faces, (x - middle) @ axes[2])
        if (sides[:, :2] @ (axes[:2] @ (loop.centroid() - middle)) + sides[:, 2] <= 0.0).all()
    ]
    return float(ConvexHull(np.concatenate(inner)).area) if inner else 0.0


def springs_of(bands: Sequence[Band], mass: Float) -> tuple[Springs, Float]:
    """Return the springs of bands, and the masses (n,) [kg] of vertices that have `mass` (n,) without bands."""
    pairs, rest = (np.concatenate([getattr(band, name) for band in bands]) for name in ("pairs", "rest"))
    mass = mass + np.bincount(pairs.reshape(-1), np.repeat(0.5 * DENSITY * rest, 2), len(mass))
    k, (one, other) = STIFFNESS / rest, mass[pairs].T
    c = 2.0 * DAMPING_RATIO * np.sqrt(k * one * other / (one + other))
    return Springs.from_pairs(pairs, k, rest, c, ELASTIC), mass
