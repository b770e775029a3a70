"""The simulation service: queries the bodies, steps the cloth, and publishes its frames."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nuno.bus.encodings import encode_arrays
from nuno.bus.messages import PendingReply
from nuno.bus.sessions import PATIENCE
from nuno.collision.bodies import vertex_normals
from nuno.collision.messages import POSES_QUERY, decode_poses
from nuno.plugin_contract import registry
from nuno.recording.reader import SETTLED, Recording, before_checkpoint, open_recording, settled_cloth
from nuno.runtime.driver import Driver, FrameWatchdog
from nuno.runtime.service import Context
from nuno.runtime.stepper import RECORDED, Stepped, require_recorded, resume
from nuno.simulation.cloth import size_warnings
from nuno.simulation.operations import name_of
from nuno.simulation.run import Simulation
from nuno.simulation.start_checks import start_warnings
from nuno.simulation.yarns import (
    edge_yarns,
    find_pressure,
    has_pressure,
    measure_courses,
    measure_stretch,
    measure_yarns,
    structural_edges,
    tension_arrays,
)
from nuno_schemas.bodies import Poses
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Fabric, Float, Int
from nuno_schemas.messages import BODIES, CONTACT, EVENT, FABRIC, STATUS, TOUCHES, BodyContact, Contact, Topic
from nuno_schemas.system import StepReport
from nuno_schemas.vectors import vertex_areas

# Poses of bodies that other programs move: queries to the collision service. All other bodies are posed here.


class LivePoses:
    """Poses of live bodies at the end of the next frame, which other programs send to the collision service."""

    def __init__(self, context: Context) -> None:
        self._context = context
        self._reply: PendingReply | None = None

    def arrived(self, frame: int) -> bool:
        """Return whether the poses of the next frame have arrived, after a query if none is out. Raises Refused where
        none will come, RunFailed where the service is gone.
        """
        reply = self._ask(frame)
        if arrived := reply.arrived():
            reply.answer()
        return arrived

    def take(self, frame: int) -> Poses:
        """Return the poses of a frame; a long wait is logged as a warning. Raises RunFailed where they do not come."""
        reply = self._ask(frame)
        self._reply = None

        def warn() -> None:
            limit = f"given up after {PATIENCE:g} s"
            text = f"waiting for the collision service: no bodies of frame {frame} yet ({limit})"
            self._context.event("warning", text)

        return decode_poses(reply.answer(warn))

    def _ask(self, frame: int) -> PendingReply:
        if self._reply is None:
            self._reply = self._context.bus.ask_ahead(POSES_QUERY, json.dumps({"frame": frame}).encode(), PATIENCE)
        return self._reply


NOW = "sim/ask/now"
"""Query for the present cloth: late subscribers have missed `sim/fabric`, and a paused run sends no state."""


class ClothAccount:
    """The account of simulated cloth, for messages and the report: its mesh, energy and stretch, the loads on bodies
    (nuno.runtime.driver.Account).
    """

    every = 1

    def __init__(self, simulation: Simulation, earlier: list[dict[str, Any]]) -> None:
        """`earlier` are statuses and events of the resumed recording before its checkpoint."""
        self.simulation = simulation
        self.counts: dict[str, int] = {}
        self.energy: list[dict[str, float]] = []
        self.stretch = self.start_stretch = 0.0
        self.relaxing = False
        """Whether stretch has only fallen since the start: it is that of the first placement, and not of a load."""
        self.rest: dict[str, float] = {}
        self.warnings: list[str] = []
        if simulation.frame == 0:
            self.warnings = size_warnings(simulation.loaded, simulation.pieces, simulation.state.x)
            self.warnings += start_warnings(
                simulation.fabric, simulation.state.x, simulation.geometry, simulation.poses
            )
        self.recall(earlier)

    @property
    def version(self) -> int:
        """Number of changes of the cloth so far."""
        return len(self.simulation.changes)

    def constant(self, frame: int) -> tuple[Topic, dict[str, NDArray[Any]], dict[str, Any]]:
        """Return the cloth's data for viewers and recordings."""
        arrays, text = describe_fabric(self.simulation)
        if frame == 0 and (rested := self.simulation.rested):
            parts = [piece.start for piece in rested], [piece.x for piece in rested]
            arrays |= dict(zip(SETTLED, map(np.concatenate, parts), strict=True))
        return FABRIC, arrays, text

    def takes(self, item: str) -> bool:
        """Return whether the added item is an operation on cloth, not a supply of dye."""
        try:
            return name_of(item) in registry.installed("nuno.operations")
        except BadInput:
            return False

    def recall(self, earlier: list[dict[str, Any]]) -> None:
        """Continue the report of the resumed recording, given its statuses and events before the checkpoint."""
        self.warnings += dict.fromkeys(fields["text"] for fields in earlier if fields.get("kind") == "warning")
        for status in (fields for fields in earlier if "stretch" in fields):
            self.energy = self.energy or [status["energy"]]
            self._note_counts(status.get("counts", {}))
            self._note_stretch(status["frame"], math.nan if status["stretch"] is None else status["stretch"])

    def loads(self) -> list[tuple[Topic, bytes]]:
        """Return the loads on bodies, and the contacts that they come from."""
        if self.simulation.geometry is None:
            return []
        contact, touches = feel(self.simulation)
        text = {"bodies": list(self.simulation.geometry.bodies)}
        return [(CONTACT, contact.model_dump_json().encode()), (TOUCHES, encode_arrays(touches, text))]

    def status_of(self, frame: Stepped) -> dict[str, Any]:
        """Return energy, stretch and size of the wrinkles, and keep them for the report."""
        report: StepReport = frame.report
        if self.simulation.loaded.scene.until == "balance" and math.isfinite(report.unbalance):
            self.rest = {"farthest": report.unbalance, "unsettled": report.unsettled}
        self._note_counts(report.counts)
        self.energy = [self.energy[0] if self.energy else dict(report.energy), dict(report.energy)]
        self._note_stretch(frame.number, report.stretch)
        standing = "all cloth stands still: "
        if report.counts.get("steps_without_motion") and not any(standing in text for text in self.warnings):
            self.warnings.append(f"{standing}{self.simulation.holds()}")
        return {
            "energy": dict(report.energy), "stretch": report.stretch, "wrinkles": self.simulation.wrinkles(),
            "counts": dict(report.counts),
        }  # fmt: skip

    def _note_counts(self, counts: Mapping[str, int]) -> None:
        """Update the largest counts of a frame."""
        for name, value in counts.items():
            self.counts[name] = max(self.counts.get(name, 0), value)

    def _note_stretch(self, frame: int, stretch: float) -> None:
        """Update the largest stretch at the start, and since it first stopped falling."""
        if frame == 0:
            self.start_stretch, self.relaxing = stretch, True
        elif not stretch <= self.stretch:
            self.relaxing = False
        self.stretch = stretch if self.relaxing else max(self.stretch, stretch)

    def pressure(self) -> dict[str, float]:
        """Return the pressure of the cloth on its bodies at the end [Pa]; empty where it cannot be computed."""
        simulation = self.simulation
        bodies = simulation.loaded.scene.bodies
        if not has_pressure(simulation.fabric) or not bodies or not np.isfinite(simulation.state.x).all():
            return {}
        return dict(find_pressure(simulation.loaded, simulation.fabric, simulation.state.x).facts)

    def facts(self, ended: str, seconds: float) -> dict[str, Any]:
        """Return energies, limits and sizes for the report."""
        simulation, fabric = self.simulation, self.simulation.fabric
        step_seconds: dict[str, float] = {}
        if ended in ("done", "stopped") and not simulation.leave[0] and seconds > 0.0:
            divided = simulation.divide(seconds)
            step_seconds = {} if simulation.leave[0] else divided
        limit = simulation.limit
        return {
            "step_seconds": step_seconds,
            "idle": simulation.idle,
            "rested": ended == "done" and simulation.frame < simulation.loaded.scene.frames,
            "limit": {"dt": limit.dt, "omega": limit.omega, "damping": limit.damping},
            "energy": self.energy,
            "stretch": self.stretch,
            "start_stretch": self.start_stretch,
            "last_stretch": measure_stretch(fabric, simulation.state.x),
            "rest": self.rest,
            "counts": self.counts,
            "warnings": self.warnings,
            "facts": {name: value for term in simulation.system.terms for name, value in term.facts.items()},
            "yarns": measure_yarns(fabric),
            "courses": measure_courses(fabric, simulation.state.x),
            "pressure": self.pressure(),
            "arranged": simulation.arranged,
            "changes": [
                change | {"measured": [*change["measured"], simulation.heights(i)]}
                for i, change in enumerate(simulation.changes)
            ],
            "vertices": fabric.number,
            "springs": fabric.springs.number if fabric.springs else 0,
            "triangles of a membrane": fabric.membrane.number if fabric.membrane else 0,
            "hinges": fabric.hinges.number if fabric.hinges else 0,
        }


def describe_fabric(simulation: Simulation) -> tuple[dict[str, NDArray[Any]], dict[str, Any]]:
    """Return arrays and text of `sim/fabric`."""
    fabric = simulation.fabric
    arrays = _constant_arrays(fabric)
    if fabric.uv is not None:
        arrays["uv"] = fabric.uv
    if (corners := fabric.corners) is not None:
        arrays |= {"corner_uv": corners.points, "corner_vertex": corners.vertex, "corner_faces": corners.faces}
    panels = None if corners is None else corners.panels
    if panels is not None:
        arrays |= {"panel_of": panels.of, "panel_edge": panels.edge, "panel_unit": panels.unit}
        arrays |= {"panel_pairs": panels.pairs, "panel_seam": panels.seam}
    yarns = edge_yarns(fabric)
    if yarns is not None:
        arrays |= {"edge_yarn": yarns} | tension_arrays(fabric)
    text = {
        "vertices": fabric.number,
        "scene": simulation.loaded.scene.name,
        "objects": [vars(piece) for piece in simulation.pieces],
        "panels": [] if panels is None else list(panels.names),
    }
    return arrays, text


def _constant_arrays(fabric: Fabric) -> dict[str, NDArray[Any]]:
    """Return the arrays of `sim/fabric` that all cloth has."""
    edges, rest = structural_edges(fabric)
    return {"faces": fabric.faces, "edges": edges, "edge_rest": rest.astype(np.float32), "pinned": fabric.pinned}


def _require_same_poses(recording: Recording, simulation: Simulation) -> None:
    """Raise BadInput where bodies are elsewhere at the checkpoint than recorded, as a changed plugin may move them."""
    message = recording.last(BODIES.name, simulation.t)
    if message is None or message.t < simulation.t - 1e-9:  # a killed run may lack those of its checkpoint
        return
    recorded, _ = recording.poses(simulation.t)
    for name, values in vars(simulation.poses).items():
        there = recorded.get(name, values)
        if np.shape(values) != np.shape(there) or not np.allclose(values, there, rtol=0.0, atol=1e-6):
            problem = f"bodies are elsewhere at {simulation.t:g} s than recorded"
            raise BadInput(problem, str(recording.path), field=name, remedy=RECORDED)


def main(context: Context) -> None:
    """Simulate one run: prepare, wait for the start, step through the frames, answer the end."""
    earlier: list[dict[str, Any]] = []
    if context.options.resume is not None:  # a separate process has read only the scene
        with open_recording(context.options.resume) as recording:
            context.loaded.settled = settled_cloth(recording)
            earlier = before_checkpoint(recording, [STATUS.name, f"{EVENT.name}/simulation"])

    watchdog = FrameWatchdog(context)
    simulation = Simulation.with_bodies(context.loaded, context.options.threads, watchdog.leave)
    live = None
    if context.loaded.live:
        while context.watch.wait_for({"collision"}, 0.1):
            context.require_supervisor()
        live = LivePoses(context)
        simulation.find_poses = live.take
    if context.loaded.scene.record.contact_forces and simulation.geometry is not None:
        require_touched(simulation)
    if context.options.resume is not None:
        with open_recording(context.options.resume) as recording:
            resume(simulation, context.options.resume)
            require_recorded(recording, FABRIC, _constant_arrays(simulation.fabric))
            if simulation.geometry is not None and live is None:
                _require_same_poses(recording, simulation)
    simulation.present()  # compiles what the steps need, so that the run itself is timed without it
    simulation.rehearse()
    driver = Driver(context, simulation, ClothAccount(simulation, earlier), watchdog, inputs=live)

    def encode_now() -> bytes:
        """Return the content of `sim/fabric`, with x (n, 3) [m], frame and t [s]."""
        arrays, text = describe_fabric(simulation)
        text |= {"frame": simulation.frame, "t": simulation.t}
        return encode_arrays(arrays | {"x": simulation.state.x}, text)

    driver.answers[NOW] = encode_now
    driver.inbox.answer(NOW)
    driver.serve()


# Forces, torques and pressures of cloth on bodies: by contact and by attached vertices.


def feel(simulation: Simulation) -> tuple[Contact, dict[str, NDArray[Any]]]:
    """Return the loads on all bodies in the present state, and the contacts: `vertex` and `body` (k,), `force` (k, 3)
    on the body [N] and `pressure` (k,) [Pa].
    """
    geometry, poses, x = simulation.geometry, simulation.poses, simulation.state.x
    contact_forces = simulation.present_touched()
    assert geometry is not None and poses is not None and contact_forces is not None
    triangles = surface_of(simulation.fabric)
    areas, normals = vertex_areas(x, triangles), vertex_normals(x, triangles)
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
        if term.bodies and not (parts and all(type(part).kernels.find("alone") for part in parts)):
            raise loaded.at(field, BadInput(problem, value=term.name, limit=", ".join(term.bodies), remedy=remedy))


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
