"""The simulation service: asks for the bodies, has cloth stepped, and publishes what only cloth has."""

from __future__ import annotations

import json
import math
import time
from collections import deque
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nuno import registry
from nuno.bus.encodings import encode_arrays
from nuno.bus.pending_reply import PendingReply, Refused, pauses
from nuno.bus.sessions import PATIENCE
from nuno.cloth.pressure import find_pressure, has_pressure
from nuno.cloth.start_checks import start_warnings
from nuno.cloth.tension import tension_arrays
from nuno.cloth.yarns import edge_yarns, measure_courses, measure_yarns, structural_edges
from nuno.collision.messages import GEOMETRY_QUESTION, POSES_QUESTION, decode_geometry, decode_poses
from nuno.recording.reader import open_recording
from nuno.recording.restore import SETTLED, settled_cloth
from nuno.service import Context
from nuno.simulation.body_forces import feel, require_touched
from nuno.simulation.operations import name_of
from nuno.simulation.run import Simulation
from nuno.stepping.driver import CONTROL, WINDOW, Driver
from nuno.stepping.resimulation import resume
from nuno.stepping.stepper import Stepped
from nuno.stepping.watchdog import FrameWatchdog
from nuno_schemas.bodies import Geometry, Poses
from nuno_schemas.errors import BadInput, RunFailed
from nuno_schemas.messages import CONTACT, FABRIC, TOUCHES
from nuno_schemas.system import StepReport

# What the simulation asks the collision service: what the bodies are, and where they are in each frame.


def ask_geometry(context: Context) -> Geometry:
    """The bodies of a run, once their service is there. Raises RunFailed if it does not come.

    How long that may take is for the supervisor to say, who then goes: a distance field may have to be built there.
    """
    while context.watch.wait_for({"collision"}, 0.1):
        context.require_supervisor()
    return decode_geometry(context.bus.ask(GEOMETRY_QUESTION))


def ask_poses(context: Context, frame: int) -> PendingReply:
    """Ask for a frame's poses now."""
    return context.bus.ask_ahead(POSES_QUESTION, json.dumps({"frame": frame}).encode(), PATIENCE)


def take_poses(context: Context, frame: int, asked: PendingReply) -> Poses:
    """The poses of a frame that were asked for, waited for; it is said where that takes long.

    The service answers between two measurements, which on a busy machine take their time; and what is asked ahead
    waits while the cloth steps. A service that dies is noticed by whoever supervises it.
    """

    def slow() -> None:
        limit = f"given up after {PATIENCE:g} s"
        context.event("warning", f"waiting for the collision service: no bodies of frame {frame} yet ({limit})")

    return decode_poses(asked.answer(slow))


class PosesAhead:
    """Poses of the next frames, asked for before the steps wait for them.

    The collision service answers between two measurements, and what the way there and back takes is shared by as many
    frames as are asked for at once.
    """

    def __init__(self, context: Context) -> None:
        self._context, self._frames = context, context.loaded.scene.frames
        self._ahead = 0 if context.loaded.live else WINDOW
        """Frames beyond the next; of bodies that are told where to be none is known yet."""
        self._coming: deque[PendingReply] = deque()

    def there(self, frame: int) -> bool:
        """Whether those of the next frame have come; they are asked for where they have not been yet. Raises Refused
        where none will come, RunFailed where the service is gone.
        """
        self._ask(frame)
        asked = self._coming[0]
        if there := asked.there():
            asked.answer()
        return there

    def take(self, frame: int) -> Poses:
        """Those of the next frame. Raises RunFailed where they do not come."""
        self._ask(frame)
        return take_poses(self._context, frame, self._coming.popleft())

    def _ask(self, frame: int) -> None:
        for ahead in range(frame + len(self._coming), min(frame + self._ahead, self._frames) + 1):
            self._coming.append(ask_poses(self._context, ahead))


NOW = "sim/ask/now"
"""What to ask for the cloth as it is: who comes late has missed `sim/fabric`, and a paused run sends no state."""
DYE_TIMEOUT = 20.0
"""How long the dye may take to answer [s], which finishes its frame first: shorter than whoever asks here waits, and
than the end of the run may take."""


class ClothDriver(Driver):
    """Runs a simulation frame by frame and answers control."""

    def __init__(self, context: Context, simulation: Simulation, attendant: FrameWatchdog) -> None:
        super().__init__(context, simulation, attendant)
        self.simulation = simulation
        self.bodies = PosesAhead(context)
        self.seconds |= {"bodies": 0.0} | ({"contact forces": 0.0} if self.scene.record.contact_forces else {})
        self.answers[NOW] = self.encode_now
        self.inbox.answer(NOW)
        self.counts: dict[str, int] = {}
        self.energy: list[dict[str, float]] = []
        self.stretch = self.start_stretch = 0.0
        self.relaxing = False
        """Whether stretch has only fallen since the start: it is how the cloth was put on, and no load does it."""
        self.started = False
        self.rest: dict[str, float] = {}
        self.warnings: list[str] = []
        """What is to be said of how the cloth starts, and of what holds it up."""
        self.stood = ""
        if simulation.poses is not None:
            simulation.find_poses = self.next_poses
        if simulation.frame == 0:
            bodies = simulation.geometry, simulation.poses
            self.warnings = start_warnings(simulation.fabric, simulation.state.x, *bodies)

    def control(self, request: dict[str, Any]) -> dict[str, Any]:
        """See `Driver`; what is added, is added to the dye where the scene has any."""
        if request.get("action") != "add" or self.scene.dye is None or _changes_cloth(request.get("item")):
            return super().control(request)
        try:
            answer = self.context.bus.ask_json(f"{CONTROL}/dye", request, DYE_TIMEOUT)
        except RunFailed as error:  # of the dye; if it is dead, the supervisor ends the run
            return {"ok": False, "error": f"{error}; it may still do what it was asked for"}
        return answer | ({"state": self.state, "before": self.state, "left": self.left} if answer["ok"] else {})

    def add(self, item: str) -> dict[str, Any]:
        """Let an operation change the cloth at once: what is to be recorded, and what the operation says.

        A checkpoint follows, so that a run resumed at this frame has the change.
        """
        said = self.simulation.add(item)
        if self.started:
            self.publish_fabric(self.simulation.frame + 1)
            self.keep()
        change = self.simulation.changes[-1]
        return {"field": change["object"], "old": None, "new": change["facts"], "item": said}

    def publish_constant(self) -> None:
        """The cloth, and what is to be said of its start."""
        self.started = True
        for text in self.warnings:
            self.context.event("warning", text, self.simulation.frame, self.simulation.t)
        self.publish_fabric(self.simulation.frame)

    def step_frame(self) -> Stepped:
        """See `Driver`; cloth that operations change by now is published first."""
        if self.simulation.alter_due():
            self.publish_fabric(self.simulation.frame + 1)
        stepped = super().step_frame()
        if stepped.report.counts.get("steps_without_motion") and not self.stood:
            self.stood = f"all cloth stands still: {self.simulation.holds()}"
            self.warnings.append(self.stood)
            self.context.event("warning", self.stood, self.simulation.frame, self.simulation.t)
        return stepped

    def publish(self, frame: Stepped, show: bool) -> None:
        """See `Driver`; with what bodies feel, where the scene wants that."""
        super().publish(frame, show)
        if self.scene.record.contact_forces and self.simulation.geometry is not None:
            start = time.perf_counter()
            contact, touches = feel(self.simulation)
            text = {"bodies": list(self.simulation.geometry.bodies)}
            self.seconds["contact forces"] += time.perf_counter() - start
            self._put(CONTACT, contact.model_dump_json().encode())
            self._put(TOUCHES, encode_arrays(touches, text))

    def ready(self) -> bool:
        """See `Driver`: where bodies are told where to be, their poses may come late, or their silence ends the run."""
        if not self.context.loaded.live:
            return True
        start, pause, frame = time.perf_counter(), pauses(), self.simulation.frame + 1
        try:
            while not self.bodies.there(frame) and self.finish is None and self.state == "running":
                self.listen(next(pause))
        except Refused as error:
            self.state, self.message = "failed", error.said
        self.seconds["bodies"] += time.perf_counter() - start
        return self.finish is None and self.state == "running"

    def next_poses(self, frame: int) -> Poses:
        """Poses at the end of the next frame."""
        start = time.perf_counter()
        poses = self.bodies.take(frame)
        self.seconds["bodies"] += time.perf_counter() - start
        return poses

    def status_of(self, frame: Stepped) -> dict[str, Any]:
        """Energy, stretch and the wrinkles' size, which the report sums up."""
        report: StepReport = frame.report
        if self.scene.until == "balance" and math.isfinite(report.unbalance):
            self.rest = {"farthest": report.unbalance, "unsettled": report.unsettled}
        for name, value in report.counts.items():
            self.counts[name] = max(self.counts.get(name, 0), value)
        self.energy = [self.energy[0] if self.energy else dict(report.energy), dict(report.energy)]
        self._note_stretch(frame.number, report.stretch)
        return {"energy": dict(report.energy), "stretch": report.stretch, "wrinkles": self.simulation.wrinkles()}

    def _note_stretch(self, frame: int, stretch: float) -> None:
        """The largest stretch at the start, and since it first ceased to fall from there."""
        if frame == 0:
            self.start_stretch, self.relaxing = stretch, True
        elif not stretch <= self.stretch:
            self.relaxing = False
        self.stretch = stretch if self.relaxing else max(self.stretch, stretch)

    def publish_fabric(self, frame: int) -> None:
        """What viewers and recordings need to know about the cloth, from `frame` on."""
        arrays, text = self.describe_fabric()
        if frame == 0 and (rested := self.simulation.rested):
            both = [one.start for one in rested], [one.x for one in rested]
            arrays |= dict(zip(SETTLED, map(np.concatenate, both), strict=True))
        self.context.bus.publisher(FABRIC).put(encode_arrays(arrays, text), frame, frame / self.scene.frame_rate)

    def encode_now(self) -> bytes:
        """What `sim/fabric` says, and x (n, 3) [m], frame and t [s]."""
        arrays, text = self.describe_fabric()
        simulation = self.simulation
        return encode_arrays(arrays | {"x": simulation.state.x}, text | {"frame": simulation.frame, "t": simulation.t})

    def describe_fabric(self) -> tuple[dict[str, NDArray[Any]], dict[str, Any]]:
        """Arrays and text of `sim/fabric`."""
        fabric = self.simulation.fabric
        edges, rest = structural_edges(fabric)
        arrays: dict[str, NDArray[Any]] = {
            "faces": fabric.faces,
            "edges": edges,
            "edge_rest": rest.astype(np.float32),
            "pinned": fabric.pinned,
        }
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
            "scene": self.scene.name,
            "objects": [vars(piece) for piece in self.simulation.pieces],
            "panels": [] if panels is None else list(panels.names),
        }
        return arrays, text

    def pressure(self) -> dict[str, float]:
        """Of the cloth on its bodies at the end [Pa]; nothing where there is none."""
        simulation = self.simulation
        if not has_pressure(simulation.fabric) or not self.scene.bodies or not np.isfinite(simulation.state.x).all():
            return {}
        return dict(find_pressure(simulation.loaded, simulation.fabric, simulation.state.x).facts)

    def facts(self, ended: str) -> dict[str, Any]:
        """Energies, limits and sizes for the report."""
        simulation, fabric = self.simulation, self.simulation.fabric
        parts: dict[str, float] = {}
        if ended in ("done", "stopped") and not simulation.leave[0] and self.seconds["steps"] > 0.0:
            parts = simulation.divide(self.seconds["steps"])
        limit = simulation.limit
        return {
            "step_seconds": parts,
            "idle": simulation.idle,
            "rested": ended == "done" and simulation.frame < self.scene.frames,
            "limit": {"dt": limit.dt, "omega": limit.omega, "damping": limit.damping},
            "energy": self.energy,
            "stretch": self.stretch,
            "start_stretch": self.start_stretch,
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


def _changes_cloth(item: object) -> bool:
    """Whether what is to be added is an operation on cloth, not dye."""
    try:
        return name_of(str(item)) in registry.installed("nuno.operations")
    except BadInput:
        return False


def main(context: Context) -> None:
    """Simulate one run: prepare, wait for the start, step through the frames, answer the end."""
    geometry = ask_geometry(context) if context.loaded.scene.bodies else None
    poses = take_poses(context, 0, ask_poses(context, 0)) if geometry is not None else None
    if context.options.resume is not None:  # a process of its own has read the scene alone
        with open_recording(context.options.resume) as recording:
            context.loaded.settled = settled_cloth(recording)

    attendant = FrameWatchdog(context)
    simulation = Simulation(context.loaded, geometry, poses, context.options.threads, attendant.leave)
    if geometry is not None:
        simulation.find_poses = lambda frame: take_poses(context, frame, ask_poses(context, frame))
    if context.loaded.scene.record.contact_forces and geometry is not None:
        require_touched(simulation)
    if context.options.resume is not None:
        resume(simulation, context.options.resume)
    simulation.present()  # compiles what the steps need, so that the run itself is timed without it
    simulation.rehearse()
    ClothDriver(context, simulation, attendant).serve()
