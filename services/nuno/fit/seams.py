"""Tension across seams.

A membrane's energy per area is W = (C_w e_w^2 + C_f e_f^2 + 2 C_wf e_w e_f + G g^2) / 2 of the strains of F_w and F_f
(nuno_schemas.fabric.Membrane). A line of the cloth as cut, with the unit normal (n_w, n_f), carries per length

    T = n_w dW/dF_w + n_f dW/dF_f,   dW/dF_w = (C_w e_w + C_wf e_f) F_w / |F_w| + G g F_f,

and dW/dF_f with the two exchanged. Each of the two edges of a seam has a triangle next to it; in cloth at rest both
pull equally, except for forces of bending, weight and contact.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nuno_schemas.fabric import Corners, Float, Int, Membrane


@dataclass(frozen=True)
class Seam:
    """A seam: its letters in the drawing of the flat pattern, the panels that it joins, and its length as cut [m].

    mean and most are those of the tension across it [N/m]; below zero its edges are pushed together.
    """

    letters: str
    panels: list[str]
    length: float
    mean: float
    most: float


def measure_seams(x: Float, membrane: Membrane, corners: Corners) -> list[Seam]:
    """Measure the tension of each seam with a length, of a garment at x (n, 3) [m] whose membrane has the triangles of
    `corners`.
    """
    panels = corners.panels
    if panels is None:
        return []
    ends = np.stack([corners.faces, np.roll(corners.faces, -1, axis=1)], axis=2).reshape(-1, 2).astype(np.int64)
    points = len(corners.points)
    keys = np.sort(ends, axis=1) @ [points, 1]
    order = np.argsort(keys)
    seams = []
    for number in np.unique(panels.seam).tolist():
        pairs = panels.pairs[panels.seam == number].astype(np.int64)
        runs = np.stack([pairs[:-1], pairs[1:]], axis=2).transpose(1, 0, 2).reshape(-1, 2)
        wanted = np.sort(runs, axis=1) @ [points, 1]
        at = order[np.minimum(np.searchsorted(keys, wanted, sorter=order), len(keys) - 1)]
        # An end of a closed short side may be in no triangle.
        at = at[keys[at] == wanted]
        if not len(at):
            continue
        length, pull = pull_across(x, membrane, at // 3, at % 3)
        names = [panels.names[k] for k in dict.fromkeys(panels.of[at // 3].tolist())]
        mean = float((length * pull).sum() / length.sum())
        seams.append(Seam(panels.letters(number), names, 0.5 * float(length.sum()), mean, float(pull.max())))
    return seams


def pull_across(x: Float, membrane: Membrane, face: Int, side: Int) -> tuple[Float, Float]:
    """Return the lengths as cut [m] of sides of triangles, each from a corner `side` (k,) of a `face` (k,) to the next,
    and the outward tension across them within the cloth [N/m], at x (n, 3) [m].
    """
    flat = np.linalg.inv(np.stack([membrane.along[face], membrane.across[face]], axis=2)).transpose(0, 2, 1)
    flat = np.concatenate([np.zeros((len(face), 1, 2)), flat], axis=1)
    placed = x[membrane.faces[face]]
    k = np.arange(len(face))
    start, end, third = ((k, (side + step) % 3) for step in range(3))
    edge, inwards = flat[end] - flat[start], flat[third] - flat[start]
    length = np.linalg.norm(edge, axis=1)
    normal = np.stack([edge[:, 1], -edge[:, 0]], axis=1) / length[:, None]
    normal *= -np.sign((normal * inwards).sum(axis=1, keepdims=True))
    yarns = np.einsum("ytc,tcd->ytd", membrane.shares()[:, face], placed)
    stress = _stress(yarns, membrane.moduli[:, face])
    traction = np.einsum("ty,ytd->td", normal, stress)
    way = placed[end] - placed[start]
    way /= np.linalg.norm(way, axis=1)[:, None]
    out = placed[start] - placed[third]
    out -= (out * way).sum(axis=1)[:, None] * way
    out /= np.linalg.norm(out, axis=1)[:, None]
    return length, (traction * out).sum(axis=1)


def _stress(yarns: Float, moduli: Float) -> Float:
    """Return dW/dF_w and dW/dF_f, shape (2, k, 3) [N/m], for F_w and F_f (2, k, 3)."""
    (warp, weft), (c_w, c_f, c_wf, g) = yarns, moduli[..., None]
    long, wide = (np.linalg.norm(one, axis=1, keepdims=True) for one in yarns)
    shear = g * (warp * weft).sum(axis=1, keepdims=True)
    along = (c_w * (long - 1.0) + c_wf * (wide - 1.0)) * warp / long + shear * weft
    across = (c_f * (wide - 1.0) + c_wf * (long - 1.0)) * weft / wide + shear * warp
    return np.stack([along, across])
