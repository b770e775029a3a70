"""The viewer service: shows a run in rerun, live, in a file, or both."""

from __future__ import annotations

import json
import time
from collections.abc import Mapping
from pathlib import Path, PurePath
from typing import Any

from nuno.bus.encodings import BadMessage, decode_arrays, encode_arrays
from nuno.bus.messages import Inbox, Message
from nuno.exports.cloth import find_named
from nuno.runtime.service import Context, Finish, each_message
from nuno.scene.provenance import assets, versions
from nuno.viewer.live import LiveView, require
from nuno.viewer.stream import END, LOOP, Subject, application, properties, scene_of
from nuno_schemas.errors import RunFailed
from nuno_schemas.messages import CHECKPOINTS, CLOTH, CONCENTRATION, EVENT, FABRIC, FRAMES, REPORT, STATE, TOPICS, Topic

EVENTS = Topic(f"{EVENT.name}/*", EVENT.encoding, EVENT.schema)
VIEWED = [topic for topic in TOPICS.values() if topic.recorded and topic.name not in CHECKPOINTS] + [EVENTS]
CLOTHS = (FABRIC.name, CLOTH.name)
"""Topics that describe the cloth of frames."""
MOST_EARLY = 64
"""Most messages that a live view keeps until the cloth is known. A file keeps all: the simulation waits for it."""
DRAIN_SECONDS = 0.1
"""Silence of the bus after the end of a run that means that no more messages will come [s]."""


class Viewer:
    """The views of one run."""

    def __init__(self, context: Context) -> None:
        self.context = context
        self.seconds = 0.0
        self.frames = 0
        self.early: list[Message] | None = []
        """Messages from before the cloth is known."""
        scene = context.loaded.scene
        self.awaited = {name for name, exists in ((FABRIC.name, scene.moves), (CLOTH.name, scene.dye)) if exists}
        options, data = context.options, context.loaded.data
        subject = Subject(
            run=context.bus.run, view=scene.view, layout=application(data), scene=scene_of(context.loaded),
            properties=properties(data, versions()),
        )  # fmt: skip
        self.file: Any = None
        if options.save is not None:
            from nuno.viewer.dyed import viewer_painter
            from nuno.viewer.file import RerunFile

            painter = None if context.loaded.dye is None else viewer_painter(context.loaded)
            self.file = RerunFile(options.save, subject, painter=painter)
        self.leader = STATE.name if scene.moves else CONCENTRATION.name
        self.live: LiveView | None = None
        if options.view:
            self.live = LiveView(options.view, subject, context.event, self.leader)
        self.acknowledges = context.bus.service in options.must_see
        # Without a file a viewer may join late, and then sees only new messages.
        self.inbox = Inbox(context.bus, VIEWED, newest_only=self.file is None)

    def handle(self, message: Message) -> None:
        """Show one message, after the description of its cloth.

        zenoh keeps no order between topics, and a frame without its cloth cannot be drawn. A
        viewer that joins late never gets the description, and stops waiting after MOST_EARLY.
        """
        if self.early is not None:
            self.early.append(message)
            self.awaited.discard(message.topic)
            if self.awaited and (self.file is not None or len(self.early) <= MOST_EARLY):
                return
            waiting, self.early = self.early, None
            for each in sorted(waiting, key=lambda kept: kept.topic not in CLOTHS):
                self.show(each)
            return
        self.show(message)

    def show(self, message: Message) -> None:
        """Show one message, and acknowledge it if it is a frame that must be seen."""
        start = time.perf_counter()
        header = message.header
        payload = message.payload
        if message.topic == FABRIC.name:
            payload = with_own_textures(payload, assets(self.context.loaded))
        self.feed(message.topic, header.frame, header.t, payload)
        if message.topic in FRAMES:
            self.frames += message.topic == self.leader
            if self.acknowledges:
                self.context.acknowledge(header.frame, header.t)
        self.seconds += time.perf_counter() - start

    def feed(self, topic: str, frame: int, t: float, payload: bytes) -> None:
        """Pass a message to the views. Raises RunFailed."""
        if self.live is not None:
            self.live.feed(topic, frame, t, payload)
        if self.file is not None:
            try:
                self.file.feed(topic, frame, t, payload)
            except BadMessage:
                self.inbox.counts.refused[topic] += 1

    def drain(self) -> None:
        """Handle all messages that are still on their way."""
        while isinstance(item := self.inbox.get(DRAIN_SECONDS), Message):
            self.handle(item)
        for message in self.early or ():
            self.show(message)
        self.early = None

    def close(self, last: str = "") -> dict[str, Any]:
        """End the views, and return a summary. A live view gets a `last` message, without which it ends, too. Raises
        RunFailed if the file could not be written.
        """
        summary: dict[str, Any] = {"frames": self.frames, "seconds": self.seconds}
        if self.file is not None:
            file, self.file = self.file, None
            summary |= {"shown": file.bridge.frames, "saved": file.bridge.frames, "file": str(file.finish())}
        if self.live is not None:
            self.live.finish(last)
            summary |= {"shown": self.live.shown, "skipped": self.live.skipped, "error": self.live.error}
            summary |= {"pid": self.live.pid, "page": self.live.page}
        return summary


def main(context: Context) -> None:
    """Show one run until asked to finish. Raises BadInput, RunFailed."""
    require(context.options.view, context.options.save)
    viewer = Viewer(context)
    try:
        finish = each_message(context, viewer.inbox, viewer.handle)
        viewer.drain()
        request = Finish.model_validate_json(finish.payload)
        if request.report:
            viewer.feed(REPORT.name, -1, 0.0, json.dumps(request.report).encode())
    except RunFailed:
        viewer.close()
        raise
    finish.answer_json(context.counts(viewer.inbox) | viewer.close(LOOP if request.loop else END))


def with_own_textures(fabric: bytes, files: Mapping[str, Path]) -> bytes:
    """Return a fabric message with the paths of images in this viewer's scene.

    The simulation names an image by its path on its own disk, at the time of the run. Here the
    scene may be elsewhere (another host), or in a recording whose files were unpacked. A path
    stands for the scene's file with whose name it ends; any other is not read: a message must not
    select files here. Other messages are returned unchanged, for the views to refuse.
    """
    try:
        arrays, text = decode_arrays(fabric)
        for piece in text["objects"]:
            if path := piece.get("texture"):
                name = find_named(str(path), files)
                piece["texture"] = str(files[name]) if name else f"{PurePath(path).name} (not among the scene's files)"
    except (BadMessage, KeyError, TypeError, AttributeError):
        return fabric
    return encode_arrays(arrays, text)
