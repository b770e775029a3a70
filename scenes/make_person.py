"""Make person.npz, the skin that capsules are drawn as: python scenes/make_person.py BODY.obj

BODY.obj is the `body` group of MakeHuman's base mesh hm08, released as CC0, triangulated, 1.666 m tall, y up, facing +z
with arms half raised: the body whose sections gave the capsules their radii and the hula dancer its joints. It is
simplified (M. Garland and P. S. Heckbert, Surface simplification using quadric error metrics, SIGGRAPH 1997; needs `pip
install fast-simplification`), and its joints and weights are found as those of any person's mesh.
"""

from __future__ import annotations

import sys
from pathlib import Path

import fast_simplification
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from nuno_contact.colliders.body_parts import PARENTS
from nuno_contact.colliders.skin import bones_of
from nuno_contact.skinning.figure import find_figure
from nuno_contact.skinning.weights import find_weights, keep_largest
from nuno_geometry.mesh_files.mesh import read_closed

Array = NDArray[np.int32]

PATH = Path(__file__).parents[1] / "plugins" / "nuno_contact" / "body_shapes" / "person.npz"
TRIANGLES = 8000
"""a face and fingers are still seen, and a frame of it is as large as one of a skirt"""

EYES, AROUND = np.array([[0.0335, 1.547, 0.115], [-0.0335, 1.547, 0.115]]), 0.023
"""the sockets of the eyes, which are open, and their size [m]: they are closed, as a mannequin's"""
PIT = 0.045
"""how far along the upper arm the armpit lies [m]"""
SPREADS = 3
"""times that weights are averaged over neighbours: arms that are raised from half way must not crease the chest"""


def neighbour_mean(faces: Array, number: int) -> csr_array:
    """Return the matrix (v, v) that averages over each vertex' neighbours."""
    pairs = np.concatenate([faces[:, [i, (i + 1) % 3]] for i in range(3)])
    joined = csr_array((np.ones(2 * len(pairs)), (np.r_[pairs[:, 0], pairs[:, 1]], np.r_[pairs[:, 1], pairs[:, 0]])),
                       shape=(number, number))  # fmt: skip
    joined.data[:] = 1.0
    return joined.multiply(1.0 / joined.sum(axis=1)[:, None]).tocsr()


x, faces = read_closed(Path(sys.argv[1]), 1.0, False, notes=[])
x, faces = fast_simplification.simplify(x.astype(np.float32), faces, target_count=TRIANGLES, agg=4)
x, faces = np.ascontiguousarray(x, np.float64), np.ascontiguousarray(faces, np.int32)
mean = neighbour_mean(faces, len(x))
socket = (np.linalg.norm(x[:, None] - EYES, axis=2) < AROUND).any(axis=1)
for _ in range(2000):  # to a membrane
    x[socket] = (mean @ x)[socket]
figure, parts = find_figure(x, faces), list(PARENTS)
part, weight = find_weights(x, faces, *bones_of(figure, parts))
dense = np.zeros((len(x), len(parts)))
np.add.at(dense, (np.arange(len(x))[:, None], part), weight)
for side in ("left", "right"):  # the side of the chest does not go with an arm that is raised
    arm, along = figure[f"{side}_arm"], figure[f"{side}_forearm"] - figure[f"{side}_arm"]
    trunk = ((x - arm) @ along / np.linalg.norm(along) < PIT) & (x[:, 1] < arm[1])
    for name in (f"{side}_arm", f"{side}_forearm", f"{side}_hand"):
        dense[trunk, parts.index("chest")] += dense[trunk, parts.index(name)]
        dense[trunk, parts.index(name)] = 0.0
chest = x[:, 1] > 1.1  # of legs weights are as local as capsules
for _ in range(SPREADS):
    dense[chest] = 0.5 * (dense + mean @ dense)[chest]
part, weight = keep_largest(dense)
print(f"{socket.sum()} vertices of sockets")
places = {"names": np.array(list(figure.places)), "places": np.stack(list(figure.places.values()))}
np.savez_compressed(
    PATH, x=x.astype(np.float32), faces=faces.astype(np.uint16), parts=np.array(parts), part=part.astype(np.uint8),
    weight=weight.astype(np.float32), height=figure.height, **places,
)  # fmt: skip
print(f"{PATH.name}: {len(x)} vertices, {len(faces)} triangles, {PATH.stat().st_size / 1000:.0f} kB")
