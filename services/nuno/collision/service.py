"""The collision service: owns the bodies, publishes their poses, measures penetration."""

from __future__ import annotations

import time
from threading import Timer
from typing import Any

import numpy as np

from nuno.bus.encodings import BadMessage, decode_arrays, decode_points
from nuno.bus.messages import Inbox, Message, Query
from nuno.collision.bodies import KEPT, NO_SURFACES, Bodies, shared_bodies, surface
from nuno.collision.crossings import Mesh, find_crossings, look, mesh_of, near_pairs
from nuno.collision.distance import Inside, measure_inside
from nuno.collision.messages import (
    DRAWN_QUERY,
    LIVE_BODIES_QUERY,
    POSES_QUERY,
    Followers,
    decode_poses,
    encode_geometry,
    encode_poses,
)
from nuno.plugin_contract import containment
from nuno.plugin_contract.values import ContractError, check_array
from nuno.recording.reader import before_checkpoint, open_recording, recorded_poses
from nuno.runtime.driver import LEAVE_AFTER
from nuno.runtime.service import LOOK_SECONDS, Context, each_message
from nuno.runtime.stepper import fitting
from nuno.scene.scene_file import Loaded
from nuno_schemas.bodies import SKIN, Poses
from nuno_schemas.errors import RunFailed
from nuno_schemas.fabric import Float, Int
from nuno_schemas.layout import Bounds
from nuno_schemas.messages import BODIES, FABRIC, GEOMETRY, PENETRATION, STATE, Header, Penetration, Topic

# Check of cloth against cloth in published frames: crossings, and the least distance; and crossings with bodies that
# the cloth contact includes.

MOST_PLACES = 100
"""Most edges whose crossings are reported."""


def checked_bodies(loaded: Loaded, bodies: Bodies | None) -> list[int]:
    """Return the numbers of bodies that no edge of cloth may pass through: those of the cloth contact, which promises
    it, and skins, whose own contact keeps off points of the cloth but not its edges.
    """
    if bodies is None:
        return []
    skins = bodies.geometry.body[bodies.geometry.kind == SKIN].tolist()
    return sorted({*loaded.scene.met_bodies, *skins})


class ClothCheck:
    """Checks a run's cloth for crossings with cloth, with the bodies of the cloth contact and with skins, and keeps the
    results.
    """

    def __init__(self, loaded: Loaded, bodies: Bodies | None) -> None:
        numbers = checked_bodies(loaded, bodies)
        self.bodies = [loaded.scene.bodies[i].name for i in numbers]
        """Names of the bodies."""
        each = [surface(bodies.geometry.of_bodies([i])) for i in numbers] if bodies is not None else []
        self.surface = surface(bodies.geometry.of_bodies(numbers)) if bodies is not None and numbers else NO_SURFACES
        self.solid = mesh_of(self.surface.faces)
        self.body = np.repeat(np.arange(len(each)), [len(one.vertices) for one in each])
        """(v,) number of the body of each surface vertex."""
        self.meet, self.objects = loaded.scene.meet(), [part.name for part in loaded.scene.objects]
        self.thickness = float(getattr(loaded.cloth_contact and loaded.cloth_contact.config, "thickness", 0.0))
        """Largest distance that is measured [m]; 0 for contact without a thickness."""
        self.mesh: Mesh | None = None
        self.through: list[Mesh] = []
        """Cloth's edges with bodies' triangles, and bodies' edges with cloth's triangles; the bodies' vertices are
        numbered after the cloth's."""
        self.names: list[str] = []
        self.piece = np.zeros(0, np.int64)
        """(n,) number of each vertex's object."""
        self.checked = self.crossed = self.most = 0
        """Checked frames, frames with crossings, and the most crossings in one frame."""
        self.first: dict[str, Any] | None = None
        """First crossing."""
        self.least: float | None = None
        """Least distance in all frames [m]."""

    def take(self, faces: Int, text: dict[str, Any]) -> None:
        """Replace the cloth by that of a fabric's message, of triangles `faces` (f, 3)."""
        number = [piece["stop"] - piece["start"] for piece in text["objects"]]
        self.names = [*(str(piece["name"]) for piece in text["objects"]), *self.bodies]
        self.mesh, n = mesh_of(faces), np.int32(text["vertices"])
        self.piece = np.repeat(np.arange(len(self.meet)), number)
        self.through = [Mesh(self.solid.faces + n, self.mesh.edges), Mesh(faces, self.solid.edges + n)]

    def look(self, points: Float, header: Header, poses: Poses | None = None) -> dict[str, Any]:
        """Return the crossings and the distance of a frame's points (n, 3), with bodies at `poses`, for its report.
        Raises BadMessage for points of another cloth.
        """
        if self.mesh is None or not np.isfinite(points).all():
            return {}
        if len(points) != len(self.piece):
            raise BadMessage(f"{len(points)} points of a cloth of {len(self.piece)} vertices")
        mesh, (edge, face) = self.mesh, near_pairs(points, self.mesh, self.thickness)
        if not self.meet.all():
            meeting = self.meet[self.piece[mesh.edges[edge, 0]], self.piece[mesh.faces[face, 0]]]
            edge, face = edge[meeting], face[meeting]
        of_cloth, distance = look(points, mesh, (edge, face), self.thickness)
        crossings = [of_cloth]
        if poses is not None and self.bodies:
            all_points = np.concatenate([points, self.surface.at(poses)])
            crossings += [find_crossings(all_points, one) for one in self.through]
        edges, triangles, crossed = (
            np.concatenate([getattr(one, name) for one in crossings]) for name in ("edges", "triangles", "places")
        )
        piece = np.concatenate([self.piece, len(self.meet) + self.body])
        places = crossed[:MOST_PLACES].tolist()
        objects = [
            (self.names[a], self.names[b])
            for a, b in piece[np.stack([edges[:, 0], triangles[:, 0]], axis=1)[:MOST_PLACES]].tolist()
        ]
        return {
            "crossings": len(crossed),
            "places": places,
            "objects": objects,
            "distance": distance,
            "thickness": self.thickness or None,
        }

    def note(self, report: Penetration) -> None:
        """Add a frame's results to those of all frames."""
        number, distances = report.crossings or 0, (self.least, report.distance)
        self.checked, self.crossed = self.checked + (report.crossings is not None), self.crossed + (number > 0)
        self.most, self.least = max(self.most, number), min((d for d in distances if d is not None), default=None)
        if number and self.first is None:
            where = {"place": report.places[0], "objects": report.objects[0]}
            self.first = {"frame": report.frame, "t": report.t} | where

    def summary(self) -> dict[str, Any]:
        """Return the results of all frames, for the report."""
        return {
            "looked": self.checked,
            "crossed": self.crossed,
            "crossings": self.most,
            "first_crossing": self.first,
            "least_distance": self.least,
            "thickness": self.thickness,
            "bodies": self.bodies,
            "allowed": [[self.objects[i], self.objects[j]] for i, j in np.argwhere(np.triu(~self.meet)).tolist()],
        }


CLOTH_AND_STATES = Topic("sim/*", "json", "")
"""One subscription for both, in which each cloth, also a changed one, arrives before its first state."""


class Collision:
    """Serves the bodies of one run, and checks its cloth if that has cloth contact."""

    def __init__(self, context: Context, bodies: Bodies | None, inbox: Inbox) -> None:
        self.context, self.bodies, self.inbox = context, bodies, inbox
        self.rate, self.frames = context.loaded.scene.frame_rate, context.loaded.scene.frames
        self.seconds = 0.0
        self.deepest = self.last = self.area = self.area_depth = 0.0
        self.cache: dict[int, Poses] = {}
        """Poses of live bodies in the last few frames."""
        self.followers: Followers | None = None
        if bodies is not None and context.loaded.live:
            self.followers = Followers(context, bodies.live(), inbox.wake)
        self.waiting: list[Query] = []
        """Queries for the poses of the next frame that wait for live bodies."""
        self.followed = 0
        """Last frame that live bodies have moved to."""
        checked = context.loaded.scene.meets or checked_bodies(context.loaded, bodies)
        self.cloth = ClothCheck(context.loaded, bodies) if checked else None
        """None where cloth may pass through all."""
        self.faces = np.zeros((0, 3), np.int32)
        """(f, 3) triangles of the cloth."""
        self.met = context.loaded.scene.met_bodies
        """Bodies of cloth contact, by number, which cloth enters only by crossings."""
        if self.followers is not None:
            self.poses(0)  # cached before the bodies move on

    def answer(self, query: Query) -> None:
        """Answer a query for the drawn bodies, the live ones, or the poses of a frame."""
        if self.bodies is None:
            self.inbox.refuse(query)
            query.refuse("the scene has no bodies")
            return
        if query.name == DRAWN_QUERY:
            query.answer(encode_geometry(self.bodies.drawn))
            return
        if query.name == LIVE_BODIES_QUERY:
            live = self.followers.describe() if self.followers is not None else {}
            query.answer_json({"bodies": self.bodies.geometry.bodies, "told": live})
            return
        frame = query.json().get("frame")
        if type(frame) is not int or not 0 <= frame <= self.frames:
            self.inbox.refuse(query)
            query.refuse(f"poses are asked for by frame, 0 to {self.frames}")
            return
        if self.followers is not None and not self._is_available(frame):
            self.inbox.refuse(query)
            query.refuse(f"bodies are told where to be in frame {self.followed + 1} next; earlier ones are recorded")
            return
        if self.followers is not None and self._is_pending(frame):
            self.waiting.append(query)
            return
        query.answer(encode_poses(self.poses(frame), frame))

    def between(self) -> float:
        """Answer waiting queries if the poses have arrived, or their time is over; return the wait for that [s]."""
        if self.followers is None or not self.waiting:
            return LOOK_SECONDS
        if (left := self.followers.wait(self.followed + 1)) > 0.0:
            return min(left, LOOK_SECONDS)
        queries, self.waiting = self.waiting, []
        try:
            frame = self.followed + 1
            payload = encode_poses(self.poses(frame), frame)
        except RunFailed as error:  # the simulation ends the run after the present frame
            for query in queries:
                query.refuse(str(error))
        else:
            for query in queries:
                query.answer(payload)
        return LOOK_SECONDS

    def poses(self, frame: int) -> Poses:
        """Return the poses of a frame."""
        assert self.bodies is not None
        if self.followers is None:
            return self.bodies.poses(frame / self.rate)
        if frame not in self.cache:
            self._follow(self.bodies, self.followers, frame)
            self.cache[frame] = self.bodies.poses(frame / self.rate)
            while len(self.cache) > KEPT:
                del self.cache[next(iter(self.cache))]
        return self.cache[frame]

    def _is_available(self, frame: int) -> bool:
        """Return whether live bodies can have poses in a frame: the next one, the last few, or a frame of the recording
        that the run resumes.
        """
        recorded_or_cached = frame in self.cache or frame in self.context.loaded.recorded_poses
        return recorded_or_cached or frame == self.followed + 1 or frame == self.followed == 0

    def _is_pending(self, frame: int) -> bool:
        """Return whether the poses of live bodies in a frame are still to come."""
        return frame > self.followed and frame not in self.context.loaded.recorded_poses

    def _follow(self, bodies: Bodies, followers: Followers, frame: int) -> None:
        """Move live bodies to the end of a frame: to their poses in the recording that the run resumes, or to those
        that have arrived.
        """
        if frame in self.context.loaded.recorded_poses:
            frames = bodies.geometry.frames
            with fitting(self.context.loaded):
                recorded = decode_poses(self.context.loaded.recorded_poses[frame], len(frames))
            followers.take_up(recorded, frames)
            self.followed = frame
        while self.followed < frame:
            self.followed += 1
            followers.go_on(self.followed, 1.0 / self.rate)

    def publish(self, header: Header) -> None:
        """Publish the poses of a frame; with the first one also the geometry, and the notes about it.

        Not before: until the first frame some services may still be starting.
        """
        if self.bodies is None:
            return
        if GEOMETRY.name not in self.context.bus.publishers:
            for note in self.bodies.notes:
                self.context.event("warning", note, header.frame, header.t)
            self.context.bus.publisher(GEOMETRY).put(encode_geometry(self.bodies.drawn), header.frame, header.t)
        payload = encode_poses(self.poses(header.frame), header.frame)
        self.context.bus.publisher(BODIES).put(payload, header.frame, header.t)

    def take(self, payload: bytes) -> None:
        """Replace the cloth by that of a message, the first one or a changed one. Raises BadMessage."""
        arrays, text = decode_arrays(payload)
        try:
            faces = arrays["faces"]
            check_array("faces", faces, np.int32, (None, 3), Bounds(0, text["vertices"] - 1))
            if self.cloth is not None:
                self.cloth.take(faces, text)
        except (LookupError, TypeError, ValueError) as error:
            raise BadMessage(f"a fabric without {error}") from None
        except ContractError as error:
            raise BadMessage(f"a wrong fabric: {error}") from None
        self.faces = faces

    def measure(self, message: Message) -> None:
        """Measure one published frame, report it and acknowledge it. Raises BadMessage."""
        header = message.header
        points = decode_points(message.payload)
        self.publish(header)
        start = time.perf_counter()
        found, poses = Inside(np.zeros(len(points)), 0.0, 0.0), None
        if self.bodies is not None:
            poses = self.poses(header.frame)
            faces = self.faces if len(points) > self.faces.max(initial=-1) else self.faces[:0]
            found = measure_inside(points, faces, self.bodies.geometry, poses, self.met)
        depth, inside = found.depth, found.depth > 0.0
        cloth = self.cloth.look(points, header, poses) if self.cloth else {}
        deepest = int(np.argmax(depth)) if inside.any() else -1
        report = Penetration(
            frame=header.frame,
            t=header.t,
            depth=float(depth[deepest]) if deepest >= 0 else 0.0,
            vertex=deepest,
            inside=int(inside.sum()),
            mean=float(depth[inside].mean()) if deepest >= 0 else 0.0,
            area=found.area,
            area_depth=found.area_depth,
            seconds=time.perf_counter() - start,
            **cloth,
        )
        self.note(report)
        self.seconds += report.seconds
        self.context.bus.publisher(PENETRATION).put(report.model_dump_json().encode(), header.frame, header.t)
        self.context.acknowledge(header.frame, header.t)
        if (
            self.bodies is not None and self.followers is None
        ):  # while the cloth steps, for a simulation in this process
            self.bodies.poses((header.frame + 2) / self.rate)

    def note(self, report: Penetration) -> None:
        """Add a frame's results to those of all frames."""
        self.deepest, self.last = max(self.deepest, report.depth), report.depth
        self.area, self.area_depth = max(self.area, report.area), max(self.area_depth, report.area_depth)
        if self.cloth is not None:
            self.cloth.note(report)


def main(context: Context) -> None:
    """Serve one run's bodies, and check its cloth, until the query to finish."""
    scene = context.loaded.scene
    if context.options.resume is not None and context.loaded.live:  # a separate process has read only the scene
        with open_recording(context.options.resume) as recording:
            context.loaded.recorded_poses = recorded_poses(recording, recording.common_checkpoint().t)

    # A plugin that does not come back leaves the query to finish unanswered.
    overdue = Timer(LEAVE_AFTER, containment.end_calls, (context.bus.run, LEAVE_AFTER))

    def on_query(query: Query) -> None:
        if query.name == f"finish/{context.bus.service}" and overdue.ident is None:
            overdue.start()

    inbox = Inbox(context.bus, [CLOTH_AND_STATES], on_query=on_query)
    collision = Collision(context, shared_bodies(context.loaded) if scene.bodies else None, inbox)
    for fields in before_checkpoint(context.options.resume, [PENETRATION.name]):
        collision.note(Penetration.model_validate(fields))
    inbox.answer(DRAWN_QUERY)
    inbox.answer(LIVE_BODIES_QUERY)
    inbox.answer(POSES_QUERY)

    def handle(message: Message) -> None:
        try:
            if message.topic == STATE.name:
                collision.measure(message)
            elif message.topic == FABRIC.name:
                collision.take(message.payload)
        except BadMessage:
            inbox.refuse(message)

    finish = each_message(context, inbox, handle, collision.answer, collision.between)
    overdue.cancel()
    facts: dict[str, Any] = {"seconds": collision.seconds}
    if scene.bodies:
        if collision.followers is not None:
            facts["followed"] = collision.followers.summary()
        facts |= {"deepest": collision.deepest, "last_depth": collision.last}
        if len(collision.met) < len(scene.bodies) and len(collision.faces):
            facts |= {"area": collision.area, "area_depth": collision.area_depth}
    if collision.cloth is not None:
        facts["cloth_contact"] = collision.cloth.summary()
    finish.answer_json(context.counts(inbox) | facts)
