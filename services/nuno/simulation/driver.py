"""Frames in lockstep with the services that must see them, under control."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from nuno.arrays import encode_arrays, encode_points
from nuno.build import structural_edges
from nuno.bus import Inbox, Message, Question
from nuno.collision.ask import ask_poses
from nuno.service import Context, ack_topic, asks_to_finish
from nuno.simulation.run import Frame, Simulation
from nuno_schemas.bodies import Poses
from nuno_schemas.errors import BadInput, RunFailed
from nuno_schemas.messages import CHECKPOINT, FABRIC, STATE, STATUS, Ack, Status
from nuno_schemas.plugin import StepReport

WINDOW = 4
"""Frames that the simulation may run ahead of a service that must see every one."""
ACK_TIMEOUT = 60.0
"""Silence [s] after which such a service counts as hung."""
CONTROL = "control"


class Driver:
    """Runs a simulation frame by frame and answers control."""

    def __init__(self, context: Context, simulation: Simulation, poses: Poses | None) -> None:
        self.context, self.simulation, self.poses = context, simulation, poses
        self.scene = context.loaded.scene
        self.state = "paused"
        self.single = 0
        self.finish: Question | None = None
        self.coming: Callable[[], Poses] | None = None
        self.acked = dict.fromkeys(context.options.must_see, -1)
        self.seconds = {"steps": 0.0, "bodies": 0.0, "waiting": 0.0, "encoding": 0.0}
        self.counts: dict[str, int] = {}
        self.totals: dict[str, int] = {}
        self.energy: list[dict[str, float]] = []
        self.stretch = 0.0
        self.message = ""
        self.begin = simulation.t
        self.paused_seconds = 0.0
        self.inbox = Inbox(context.bus, [ack_topic("*")])
        self.inbox.answer(CONTROL)
        self.inbox.answer("finish/simulation")

    # One queue brings acknowledgements, control and the end of the run, in order.
    def listen(self, timeout: float) -> None:
        """Handle one thing from the inbox, if one comes in time."""
        item = self.inbox.get(timeout)
        if isinstance(item, Message):
            try:
                ack = Ack.model_validate_json(item.payload)
            except ValidationError:
                self.inbox.refuse(item)
                return
            if item.topic != ack_topic(ack.service).name or ack.frame > self.simulation.frame:
                self.inbox.refuse(item)
            elif ack.service in self.acked:
                self.acked[ack.service] = max(self.acked[ack.service], ack.frame)
        elif isinstance(item, Question) and item.name == CONTROL:
            item.answer_json(self.control(item.json()))
        elif isinstance(item, Question):
            if asks_to_finish(self.inbox, item):
                self.finish = item
        elif timeout > 0 and self.context.orphaned():
            raise RunFailed("the supervisor has gone")

    def control(self, request: dict[str, Any]) -> dict[str, Any]:
        """Carry out one control request; the answer says what happened.

        `left` are the frames after which a run that was told to step pauses again, 0 for none.
        """
        action, simulation = str(request.get("action")), self.simulation
        before, change = self.state, {}
        if action in ("pause", "resume", "stop"):
            self.single = 0
        if action in ("start", "resume"):
            self.state = "running"
        elif action == "pause":
            self.state = "paused"
        elif action == "step":
            frames = request.get("frames", 1)
            if type(frames) is not int or not 1 <= frames <= self.scene.frames:
                problem = f"step takes a number of frames, 1 to {self.scene.frames}: {frames!r:.60}"
                return {"ok": False, "error": problem}
            self.state, self.single = "running", frames
        elif action == "stop":
            self.state = "stopped"
        elif action == "set":
            try:
                change = self.change(str(request.get("item")))
            except BadInput as error:
                return {"ok": False, "error": str(error)}
        elif action != "status":
            return {"ok": False, "error": f"unknown action {action!r}; known: pause, resume, step, stop, set, status"}
        if action not in ("start", "status"):
            args = {name: request[name] for name in ("item", "frames") if name in request}
            self.context.event("control", action, simulation.frame, simulation.t, **args)
        return {
            "ok": True,
            "state": self.state,
            "before": before,
            "left": self.single,
            "frame": simulation.frame,
            "frames": self.scene.frames,
            "t": simulation.t,
        } | change

    def change(self, item: str) -> dict[str, Any]:
        """Set a field of the running scene; its name, and what it held before and holds now."""
        field = item.partition("=")[0]
        before = self.simulation.loaded.value(field)
        self.simulation.set(item)
        return {"field": field, "old": before, "new": self.simulation.loaded.value(field)}

    def run(self) -> str:
        """All frames; how it ended: done, stopped, diverged, unconverged or (asked to finish early) failed."""
        simulation = self.simulation
        self.publish_fabric()
        measured = simulation.measure(self.poses)
        self.publish(Frame(simulation.frame, measured, 0.0, simulation.digest()), "running")
        while not simulation.finished:
            self.listen(0)
            self.stand_still()
            if self.finish is not None:
                return "failed"
            if self.state == "stopped":
                break
            status = self.one_frame().status
            if status != "ok":
                return status
            if self.single:
                self.single -= 1
                self.state = "running" if self.single else "paused"
        self.publish_checkpoint()
        self.wait_for(simulation.frame)
        return "stopped" if self.state == "stopped" else "done"

    def stand_still(self) -> None:
        """Wait while the run is paused; that time is counted apart."""
        start = time.perf_counter()
        while self.state == "paused" and self.finish is None:
            self.listen(0.5)
        self.paused_seconds += time.perf_counter() - start

    def one_frame(self) -> StepReport:
        """Ask for the bodies, step, publish."""
        simulation = self.simulation
        start = time.perf_counter()
        end = self.next_poses() if self.poses is not None else None
        self.seconds["bodies"] += time.perf_counter() - start
        frame = simulation.advance(self.poses, end)
        self.poses = end
        self.seconds["steps"] += frame.seconds
        for name, value in frame.report.counts.items():
            self.counts[name] = max(self.counts.get(name, 0), value)
        for name, value in frame.report.totals.items():
            self.totals[name] = self.totals.get(name, 0) + value
        ok = frame.report.status == "ok"
        self.message = frame.report.message
        self.publish(frame, "running" if ok else frame.report.status)
        every = self.scene.record.checkpoint_every
        if (
            ok
            and every is not None
            and frame.number % max(1, round(every * self.scene.frame_rate)) == 0
            and frame.number < self.scene.frames
        ):
            self.publish_checkpoint()
        self.wait_for(frame.number - WINDOW)
        return frame.report

    def next_poses(self) -> Poses:
        """Poses at the end of the next frame.

        Those of the frame after it are asked for at once: the collision service answers between two
        measurements, and the steps do not wait for it.
        """
        frame = self.simulation.frame + 1
        answer = self.coming or ask_poses(self.context, frame)
        poses = answer()
        self.coming = ask_poses(self.context, frame + 1) if frame < self.scene.frames else None
        return poses

    def publish(self, frame: Frame, state: str) -> None:
        start = time.perf_counter()
        simulation, bus, report = self.simulation, self.context.bus, frame.report
        self.energy = [self.energy[0] if self.energy else dict(report.energy), dict(report.energy)]
        self.stretch = max(self.stretch, report.stretch)
        points = encode_points(simulation.state.x, simulation.t)
        status = Status.model_validate(
            {
                "frame": frame.number,
                "t": simulation.t,
                "digest": frame.digest,
                "state": state,
                "steps": report.steps,
                "step_seconds": frame.seconds,
                "energy": dict(report.energy),
                "stretch": report.stretch,
                "message": report.message,
            }
        )
        self.seconds["encoding"] += time.perf_counter() - start
        bus.publisher(STATE).put(points, frame.number, simulation.t, frame.digest)
        bus.publisher(STATUS).put(status.model_dump_json().encode(), frame.number, simulation.t, frame.digest)

    def publish_fabric(self) -> None:
        """What viewers and recordings need to know about the cloth, once."""
        self.context.bus.publisher(FABRIC).put(self.encode_fabric(), self.simulation.frame, self.simulation.t)

    def encode_fabric(self) -> bytes:
        fabric = self.simulation.fabric
        edges, rest = structural_edges(fabric)
        arrays = {
            "faces": fabric.faces,
            "edges": edges,
            "edge_rest": rest.astype(np.float32),
            "pinned": fabric.pinned,
        }
        if fabric.uv is not None:
            arrays["uv"] = fabric.uv
        text = {
            "vertices": fabric.number,
            "scene": self.scene.name,
            "objects": [vars(piece) for piece in self.simulation.pieces],
        }
        return encode_arrays(arrays, text)

    def publish_checkpoint(self) -> None:
        """The whole float64 state, enough to go on from in the same bits."""
        simulation = self.simulation
        arrays: dict[str, NDArray[Any]] = {"x": simulation.state.x, "v": simulation.state.v}
        arrays |= {f"memory/{name}": values for name, values in simulation.memory.arrays.items()}
        digest = simulation.digest()
        text = {
            "t": simulation.t,
            "frame": simulation.frame,
            "digest": digest,
            "dt": simulation.dt,
            "steps": simulation.steps,
        }
        self.context.bus.publisher(CHECKPOINT).put(encode_arrays(arrays, text), simulation.frame, simulation.t, digest)

    def summary(self, ended: str, wall: float) -> dict[str, Any]:
        """What the report says of this service."""
        simulation, fabric = self.simulation, self.simulation.fabric
        parts: dict[str, float] = {}
        if ended in ("done", "stopped") and self.seconds["steps"] > 0.0:
            parts = {n: share * self.seconds["steps"] for n, share in simulation.shares(self.poses).items()}
        limit = simulation.limit
        return {
            "state": ended,
            "message": self.message,
            "frame": simulation.frame,
            "t": simulation.t,
            "began": self.begin,
            "simulated_seconds": simulation.t - self.begin,
            "digest": simulation.digest(),
            "wall_seconds": wall - self.paused_seconds,
            "paused_seconds": self.paused_seconds,
            "seconds": self.seconds,
            "step_seconds": parts,
            "steps_per_frame": simulation.steps,
            "idle": simulation.idle,
            "rested": ended == "done" and simulation.frame < self.scene.frames,
            "dt": simulation.dt,
            "limit": {"dt": limit.dt, "omega": limit.omega, "damping": limit.damping},
            "energy": self.energy,
            "stretch": self.stretch,
            "counts": self.counts,
            "totals": self.totals,
            "facts": {name: value for term in simulation.system.terms for name, value in term.facts.items()},
            "threads": simulation.about(),
            "vertices": fabric.number,
            "springs": fabric.springs.number if fabric.springs else 0,
            "hinges": fabric.hinges.number if fabric.hinges else 0,
        }

    def wait_for(self, frame: int) -> None:
        """Wait until every service that must see `frame` has. Raises RunFailed for a hung one."""
        start = time.perf_counter()
        while self.finish is None and min(self.acked.values(), default=frame) < frame:
            self.listen(0.5)
            if time.perf_counter() - start > ACK_TIMEOUT:
                late = [name for name, seen in self.acked.items() if seen < frame]
                raise RunFailed(f"{', '.join(late)} has not acknowledged frame {frame} within {ACK_TIMEOUT:g} s")
        self.seconds["waiting"] += time.perf_counter() - start
