"""Forces, torques and pressures of cloth on bodies: by contact and by attached vertices."""

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
    """Return the loads on all bodies in the present state, and the contacts: `vertex` and `body` (k,), `force` (k, 3)
    on the body [N] and `pressure` (k,) [Pa].
    """
    geometry, poses, x = simulation.geometry, simulation.poses, simulation.state.x
    contact_forces = simulation.present_touched()
    assert geometry is not None and poses is not None and contact_forces is not None
    triangles = surface_of(simulation.fabric)
    areas, normals = areas_of(x, triangles), vertex_normals(x, triangles)
    owners = np.array([geometry.bodies.index(name.split("/", 1)[0]) for name in geometry.frames], np.int32)
    attached_vertices = _attached_vertices(simulation, owners)
    contacts, columns = [], []
    for number, name in enumerate(geometry.bodies):
        force = -contact_forces.by.get(name, np.zeros_like(x))
        vertices = np.flatnonzero(force.any(axis=1)).astype(np.int32)
        normal = np.abs(np.einsum("ni,ni->n", force[vertices], normals[vertices]))
        area = areas[vertices]
        pressure = np.divide(normal, area, out=np.zeros(len(area)), where=area > 0.0)
        attached = attached_vertices[number]
        pull = contact_forces.total[attached]
        places, forces = np.concatenate([x[vertices], x[attached]]), np.concatenate([force[vertices], pull])
        origin = poses.translation[int(np.argmax(owners == number))]
        contacts.append(
            BodyContact(
                body=name, force=_sum(forces), torque=_sum(np.cross(places - origin, forces)), attached=_sum(pull),
                vertices=len(vertices), **_pressure_facts(area, normal, pressure, len(triangles) > 0),
            )
        )  # fmt: skip
        columns.append((vertices, np.full(len(vertices), number, np.int32), force[vertices], pressure))
    vertex, body, force, pressure = (np.concatenate(parts) for parts in zip(*columns, strict=True))
    force, pressure = force.astype(np.float32), pressure.astype(np.float32)
    arrays = {"vertex": vertex, "body": body, "force": force, "pressure": pressure}
    return Contact(frame=simulation.frame, t=simulation.t, bodies=contacts), arrays


def surface_of(fabric: Fabric) -> Int:
    """Return the triangles of a fabric (f, 3), the halves of the cells of a knit; a net has no rows."""
    if len(fabric.faces) or fabric.cells is None:
        return fabric.faces
    return np.concatenate([fabric.cells[:, [0, 1, 2]], fabric.cells[:, [0, 2, 3]]])


def require_touched(simulation: Simulation) -> None:
    """Raise BadInput for a solver or a contact plugin that cannot attribute contact forces to bodies."""
    loaded, problem = simulation.loaded, "contact forces are asked for, and this does not tell those of each body"
    field, remedy = "record.contact_forces", "leave them out, or take a solver and contact of nuno"
    if not hasattr(simulation.solver.plugin, "touched"):
        raise loaded.at(field, BadInput(problem, value=loaded.integrator.name, remedy=remedy))
    for term in simulation.system.terms:
        parts = () if callable(term.data) else term.data
        if term.bodies and not (parts and all(type(part).kernels.find("report.alone") for part in parts)):
            raise loaded.at(field, BadInput(problem, value=term.name, limit=", ".join(term.bodies), remedy=remedy))


def areas_of(x: Float, faces: Int) -> Float:
    """Return the area of each vertex, a third of its triangles' area, shape (n,) [m^2]."""
    a, b, c = (x[faces[:, i]] for i in range(3))
    each = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 6.0
    return np.asarray(np.bincount(faces.ravel(), np.repeat(each, 3), len(x)), np.float64)


def _attached_vertices(simulation: Simulation, owners: Int) -> list[Int]:
    """Return the vertices attached to each body; `owners` (f,) is the body of each frame."""
    carried, numbers = simulation.system.carried, simulation.numbers
    empty = np.zeros(0, np.int32)
    vertices = np.concatenate([empty, *(np.asarray(attachment.vertices) for attachment in carried)])
    bodies = owners[np.concatenate([empty, *(np.asarray(attachment.frame) for attachment in carried)])]
    user_vertices = vertices if numbers is None else numbers[vertices]
    return [user_vertices[bodies == number] for number in range(int(owners.max()) + 1)]


def _pressure_facts(area: Float, normal: Float, pressure: Float, has_surface: bool) -> dict[str, float | None]:
    """Return the contact area of a body, and the largest and the mean pressure on it."""
    if not has_surface:
        return {"area": None, "pressure": None, "mean_pressure": None}
    whole = float(area.sum())
    mean = float(normal.sum()) / whole if whole > 0.0 else 0.0
    return {"area": whole, "pressure": float(pressure.max(initial=0.0)), "mean_pressure": mean}


def _sum(forces: Float) -> tuple[float, float, float]:
    total = forces.sum(axis=0)
    return float(total[0]), float(total[1]), float(total[2])
