"""Skinning weights of bones by heat that flows over the surface from the nearest bone.

Of each bone the weights w are what

    (L + H) w = H p

says, with L the cotangent Laplacian (nuno_geometry.harmonic), H HEAT times the vertex' area over the square of
its distance to the nearest bone, and p 1 where that bone is the nearest and 0 elsewhere (I. Baran and J. Popovic,
Automatic rigging and animation of 3D characters, SIGGRAPH 2007, 4). The matrix is an M-matrix and the p add up to one,
so that weights lie in [0, 1] and add up to one, and they pass from one bone to the next over about the limb's
thickness. Nearest is among the bones that a vertex sees through the body, so that a hand beside a thigh does not carry
it.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_array

from nuno_geometry.closest_point import closest_points
from nuno_geometry.harmonic import edge_weights, solve_gradients
from nuno_geometry.tree import build_tree
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Float, Int
from nuno_schemas.vectors import dot, norm, vertex_areas

HEAT = 1.0
"""factor of H: the larger, the shorter the way over which weights pass from bone to bone"""
CARRIERS = 4
"""most bones that carry a vertex"""
LOOKS = (0.1, 0.25, 0.4, 0.55, 0.7, 0.85)
"""shares of the way from a vertex to a bone; all must be inside of the body for the bone to be visible"""
NEAREST = 1e-3
"""share of the body's height that distances have at least"""
ACCURACY, ROUNDS = 1e-7, 2000
"""residual of the solution, as a share of that at the start"""
BITS = 2.0**32
"""weights are whole numbers over this, so that they add up to one exactly in any order"""


def find_weights(x: Float, faces: Int, ends: Float, bone: Int) -> tuple[Int, Float]:
    """Return the parts that carry each vertex (v, CARRIERS), by number, the heaviest first, and their weights (v,
    CARRIERS).

    x (v, 3) [m], faces (f, 3) of a closed mesh; ends (b, 2, 3) [m] of bones, of which bone (b,) is of which part.
    """
    nearest, distance = see_bones(x, faces, ends)
    parts = int(bone.max()) + 1
    heat = spread_heat(x, faces, np.asarray(bone)[nearest], distance, parts)
    return keep_largest(heat)


def see_bones(x: Float, faces: Int, ends: Float) -> tuple[Int, Float]:
    """Return the nearest visible bone (v,) of each vertex, and its distance (v,) [m]; the nearest if it sees none."""
    start, along = ends[:, 0], ends[:, 1] - ends[:, 0]
    part = np.clip(dot(x[:, None] - start, along) / np.maximum(dot(along, along), 1e-30), 0.0, 1.0)
    near = start + part[..., None] * along
    distance = norm(x[:, None] - near)
    order = np.argsort(distance, axis=1, kind="stable")
    found, tree = order[:, 0].copy(), build_tree(x, faces)
    waiting = np.arange(len(x))
    for turn in range(ends.shape[0]):
        to = near[waiting, order[waiting, turn]]
        seen = np.ones(len(waiting), bool)
        for share in LOOKS:
            seen &= np.asarray(closest_points(tree, x[waiting] + share * (to - x[waiting])).distance) < 0.0
        found[waiting[seen]] = order[waiting[seen], turn]
        waiting = waiting[~seen]
        if not len(waiting):
            break
    least = NEAREST * float(np.ptp(x[:, 1]))
    return found.astype(np.int32), np.maximum(distance[np.arange(len(x)), found], least)


def spread_heat(x: Float, faces: Int, part: Int, distance: Float, parts: int) -> Float:
    """Return the heat of each part at each vertex (v, parts). Raises BadInput for a mesh on which it is not found."""
    pairs, weight = edge_weights(x, faces)
    number = len(x)
    i, j = pairs.T
    source = HEAT * vertex_areas(x, faces) / distance**2
    diagonal = np.bincount(i, weight, number) + np.bincount(j, weight, number) + source
    rows, columns = np.concatenate([i, j, np.arange(number)]), np.concatenate([j, i, np.arange(number)])
    matrix = csr_array((np.concatenate([-weight, -weight, diagonal]), (rows, columns)), shape=(number, number))
    right = np.zeros((number, parts))
    right[np.arange(number), part] = source
    heat = np.zeros((number, parts))
    heat[np.arange(number), part] = 1.0
    what = "weights of its joints are found for this body"
    residual = right - matrix @ heat
    try:
        return solve_gradients(lambda p: matrix @ p, diagonal[:, None], residual, heat, ACCURACY, ROUNDS, what)
    except BadInput as error:
        raise error.at("file") from None


def keep_largest(heat: Float) -> tuple[Int, Float]:
    """Return the largest of (v, parts), less the largest left out, so that they pass to 0 smoothly; of sum one."""
    weights = min(CARRIERS, heat.shape[1])
    order = np.argsort(-heat, axis=1, kind="stable")
    largest = np.take_along_axis(heat, order, axis=1)
    beyond = largest[:, weights : weights + 1] if heat.shape[1] > weights else 0.0
    weight = np.maximum(largest[:, :weights] - np.maximum(beyond, 0.0), 0.0)
    weight = np.where(weight.any(axis=1, keepdims=True), weight, largest[:, :weights])
    weight = np.round(weight / weight.sum(axis=1, keepdims=True) * BITS) / BITS
    weight[:, 0] = 1.0 - weight[:, 1:].sum(axis=1)
    return order[:, :weights].astype(np.int32), weight
