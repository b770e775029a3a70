"""The collision service: owns the bodies, answers where they are, measures penetration."""

from __future__ import annotations

import time

import numpy as np
from nuno_schemas.bodies import Poses
from nuno_schemas.messages import BODIES, GEOMETRY, PENETRATION, STATE, Ack, Penetration

from nuno.arrays import BadMessage, decode_points
from nuno.build import Bodies, build_bodies
from nuno.bus import Inbox, Message, Question
from nuno.collision.distance import signed_distance
from nuno.collision.messages import encode_geometry, encode_poses
from nuno.service import Context, ack_topic, each_message

GEOMETRY_QUESTION = "collision/ask/geometry"
POSES_QUESTION = "collision/ask/poses"


class Collision:
    """Bodies of one run."""

    def __init__(self, context: Context, bodies: Bodies) -> None:
        self.context, self.bodies = context, bodies
        self.rate = context.loaded.scene.frame_rate
        self.seconds = 0.0
        self.deepest = 0.0
        self.published = -1
        self.ready: tuple[int, Poses] = (0, bodies.poses(0.0))

    def answer(self, question: Question) -> None:
        """The geometry, or the poses of a frame; what was answered is published too."""
        if question.name == GEOMETRY_QUESTION:
            payload = encode_geometry(self.bodies.geometry)
            self.context.bus.publisher(GEOMETRY).put(payload)
            question.answer(payload)
            return
        frame = int(question.json().get("frame", 0))
        poses = self.poses(frame)
        payload = encode_poses(poses, frame)
        question.answer(payload)
        if frame > self.published:
            self.published = frame
            self.context.bus.publisher(BODIES).put(payload, frame, poses.t)
        # While the simulation steps with these, get ready what it will ask next.
        self.poses(frame + 1)

    def poses(self, frame: int) -> Poses:
        """Poses of a frame, computed once if frames are asked for in order."""
        if self.ready[0] != frame:
            self.ready = (frame, self.bodies.poses(frame / self.rate))
        return self.ready[1]

    def measure(self, message: Message) -> None:
        """Measure one published frame, report it and acknowledge it."""
        start = time.perf_counter()
        header = message.header
        points = decode_points(message.payload)
        distance = signed_distance(points, self.bodies.geometry, self.bodies.poses(header.t))
        inside = distance < 0.0
        deepest = int(np.argmin(distance)) if inside.any() else -1
        report = Penetration(
            frame=header.frame,
            t=header.t,
            depth=float(-distance[deepest]) if deepest >= 0 else 0.0,
            vertex=deepest,
            inside=int(inside.sum()),
            mean=float(-distance[inside].mean()) if deepest >= 0 else 0.0,
            seconds=time.perf_counter() - start,
        )
        self.deepest = max(self.deepest, report.depth)
        self.seconds += report.seconds
        self.context.bus.publisher(PENETRATION).put(report.model_dump_json().encode(), header.frame, header.t)
        ack = Ack(service="collision", frame=header.frame)
        self.context.bus.publisher(ack_topic("collision")).put(ack.model_dump_json().encode(), header.frame, header.t)


def main(context: Context) -> None:
    """Serve one run's bodies until asked to finish."""
    collision = Collision(context, build_bodies(context.loaded))
    inbox = Inbox(context.bus, [STATE])
    inbox.answer(GEOMETRY_QUESTION)
    inbox.answer(POSES_QUESTION)

    def handle(message: Message) -> None:
        try:
            collision.measure(message)
        except BadMessage:
            inbox.counts.refused[message.topic] += 1

    finish = each_message(context, inbox, handle, collision.answer)
    finish.answer_json(context.counts(inbox) | {"seconds": collision.seconds, "deepest": collision.deepest})
