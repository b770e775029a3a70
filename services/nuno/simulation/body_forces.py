"""What bodies feel of cloth: force, torque and pressure, of what touches them and of what is attached to them."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from nuno.collision.surfaces import vertex_normals
from nuno.simulation.run import Simulation
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Fabric, Float, Int
from nuno_schemas.messages import BodyContact, Contact


def feel(simulation: Simulation) -> tuple[Contact, dict[str, NDArray[Any]]]:
    """What all bodies feel in the present state, and each touch: `vertex` and `body` (k,), `force` (k, 3) on the body
    [N] and `pressure` (k,) [Pa].
    """
    geometry, poses, x = simulation.geometry, simulation.poses, simulation.state.x
    found = simulation.present_touched()
    assert geometry is not None and poses is not None and found is not None
    around = surface_of(simulation.fabric)
    areas, normals = areas_of(x, around), vertex_normals(x, around)
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
                vertices=len(vertices), **_pressed(area, normal, pressure, len(around) > 0),
            )
        )  # fmt: skip
        touches.append((vertices, np.full(len(vertices), number, np.int32), force[vertices], pressure))
    vertex, of, force, pressure = (np.concatenate(parts) for parts in zip(*touches, strict=True))
    arrays = {"vertex": vertex, "body": of, "force": force.astype(np.float32), "pressure": pressure.astype(np.float32)}
    return Contact(frame=simulation.frame, t=simulation.t, bodies=felt), arrays


def surface_of(fabric: Fabric) -> Int:
    """(f, 3) its triangles, or of a knit the halves of its cells; none of a net that has neither."""
    if len(fabric.faces) or fabric.cells is None:
        return fabric.faces
    return np.concatenate([fabric.cells[:, [0, 1, 2]], fabric.cells[:, [0, 2, 3]]])


def require_touched(simulation: Simulation) -> None:
    """Raises BadInput for a solver, and for contact, that does not tell what each body feels."""
    loaded, problem = simulation.loaded, "contact forces are asked for, and this does not tell those of each body"
    field, remedy = "record.contact_forces", "leave them out, or take a solver and contact of nuno"
    if not hasattr(simulation.solver.plugin, "touched"):
        raise loaded.at(field, BadInput(problem, value=loaded.integrator.name, remedy=remedy))
    for term in simulation.system.terms:
        parts = () if callable(term.data) else term.data
        if term.bodies and not (parts and all(type(part).kernels.find("alone") for part in parts)):
            raise loaded.at(field, BadInput(problem, value=term.name, limit=", ".join(term.bodies), remedy=remedy))


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


def _pressed(area: Float, normal: Float, pressure: Float, known: bool) -> dict[str, float | None]:
    """Of the vertices that touch a body: their area, and the largest and the mean pressure."""
    if not known:
        return {"area": None, "pressure": None, "mean_pressure": None}
    whole = float(area.sum())
    mean = float(normal.sum()) / whole if whole > 0.0 else 0.0
    return {"area": whole, "pressure": float(pressure.max(initial=0.0)), "mean_pressure": mean}


def _sum(forces: Float) -> tuple[float, float, float]:
    total = forces.sum(axis=0)
    return float(total[0]), float(total[1]), float(total[2])
