"""What bodies feel of cloth: force, torque and pressure, of what touches them and of what is attached to them."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from nuno.collision.surfaces import vertex_normals
from nuno.simulation.run import Simulation
from nuno_schemas.fabric import Float, Int
from nuno_schemas.messages import BodyContact, Contact


def feel(simulation: Simulation) -> tuple[Contact, dict[str, NDArray[Any]]]:
    """What all bodies feel in the present state, and each touch: `vertex` and `body` (k,), `force` (k, 3) on the body
    [N] and `pressure` (k,) [Pa].
    """
    geometry, poses, x = simulation.geometry, simulation.poses, simulation.state.x
    found = simulation.present_touched()
    assert geometry is not None and poses is not None and found is not None
    areas, normals = areas_of(x, simulation.fabric.faces), vertex_normals(x, simulation.fabric.faces)
    owners = np.array([geometry.bodies.index(name.split("/", 1)[0]) for name in geometry.frames], np.int32)
    attached_to = _attached(simulation, owners)
    felt, touches = [], []
    for number, name in enumerate(geometry.bodies):
        force = -found.by.get(name, np.zeros_like(x))
        vertices = np.flatnonzero(force.any(axis=1)).astype(np.int32)
        normal = np.abs(np.einsum("ni,ni->n", force[vertices], normals[vertices]))
        area = areas[vertices]
        pressure = np.divide(normal, area, out=np.zeros(len(area)), where=area > 0.0)
        attached = attached_to[number]
        pull = found.total[attached]
        places, forces = np.concatenate([x[vertices], x[attached]]), np.concatenate([force[vertices], pull])
        origin = poses.translation[int(np.argmax(owners == number))]
        felt.append(
            BodyContact(
                body=name, force=_sum(forces), torque=_sum(np.cross(places - origin, forces)), attached=_sum(pull),
                vertices=len(vertices), area=float(area.sum()), pressure=float(pressure.max(initial=0.0)),
                mean_pressure=float(normal.sum() / area.sum()) if area.any() else 0.0,
            )
        )  # fmt: skip
        touches.append((vertices, np.full(len(vertices), number, np.int32), force[vertices], pressure))
    vertex, of, force, pressure = (np.concatenate(parts) for parts in zip(*touches, strict=True))
    arrays = {"vertex": vertex, "body": of, "force": force.astype(np.float32), "pressure": pressure.astype(np.float32)}
    return Contact(frame=simulation.frame, t=simulation.t, bodies=felt), arrays


def areas_of(x: Float, faces: Int) -> Float:
    """(n,) a third of the triangles around each vertex [m^2]."""
    a, b, c = (x[faces[:, i]] for i in range(3))
    each = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 6.0
    return np.asarray(np.bincount(faces.ravel(), np.repeat(each, 3), len(x)), np.float64)


def _attached(simulation: Simulation, owners: Int) -> list[Int]:
    """Of each body the vertices that its frames carry, which are of the bodies `owners` (f,)."""
    carried, numbers = simulation.system.carried, simulation.numbers
    none = np.zeros(0, np.int32)
    vertices = np.concatenate([none, *(np.asarray(one.vertices) for one in carried)])
    body = owners[np.concatenate([none, *(np.asarray(one.frame) for one in carried)])]
    given = vertices if numbers is None else numbers[vertices]
    return [given[body == number] for number in range(int(owners.max()) + 1)]


def _sum(forces: Float) -> tuple[float, float, float]:
    total = forces.sum(axis=0)
    return float(total[0]), float(total[1]), float(total[2])
