"""The viewer service: shows a run in rerun, live, in a file, or both; and writes rerun files of recordings."""

from __future__ import annotations

import time
from collections.abc import Mapping
from pathlib import Path, PurePath
from typing import TYPE_CHECKING, Any

from nuno.bus.encodings import BadMessage, decode_arrays, encode_arrays
from nuno.bus.messages import Inbox, Message
from nuno.exports.cloth import find_named
from nuno.runtime.service import Context, each_message
from nuno.scene.provenance import assets
from nuno.scene.scene_file import Loaded
from nuno.viewer.live import LiveView, require
from nuno.viewer.stream import scene_of
from nuno_schemas.errors import RunFailed
from nuno_schemas.messages import CHECKPOINTS, CLOTH, CONCENTRATION, EVENT, FABRIC, FRAMES, STATE, TOPICS, Topic

if TYPE_CHECKING:
    from nuno.dye.painter import DyePainter
import os
import threading
from contextlib import ExitStack
from typing import BinaryIO

import rerun as rr
from pydantic import ValidationError

from nuno.dye.painter import DyePainter
from nuno.exports.cloth import read_texture
from nuno.recording.reader import Recording
from nuno.recording.writer import part_of
from nuno.scene.recorded_scene import restored_scene
from nuno.viewer.bridge import APPLICATION, Bridge
from nuno.viewer.cloth import ReadImage, read_image
from nuno.viewer.dyed import viewer_painter
from nuno_schemas.errors import BadInput
from nuno_schemas.scene import View

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
        options, view = context.options, context.loaded.scene.view
        self.file: Any = None
        if options.save is not None:
            self.file = RerunFile(options.save, context.bus.run, view, painter=_painter(context.loaded))
        dyed_scene = scene_of(context.loaded)
        self.leader = STATE.name if scene.moves else CONCENTRATION.name
        self.live: LiveView | None = None
        if options.view:
            self.live = LiveView(options.view, context.bus.run, view, context.event, dyed_scene, self.leader)
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
        if self.live is not None:
            self.live.feed(message.topic, header.frame, header.t, payload)
        if self.file is not None:
            try:
                self.file.feed(message.topic, header.frame, header.t, payload)
            except BadMessage:
                self.inbox.counts.refused[message.topic] += 1
        if message.topic in FRAMES:
            self.frames += message.topic == self.leader
            if self.acknowledges:
                self.context.acknowledge(header.frame, header.t)
        self.seconds += time.perf_counter() - start

    def drain(self) -> None:
        """Handle all messages that are still on their way."""
        while isinstance(item := self.inbox.get(DRAIN_SECONDS), Message):
            self.handle(item)
        for message in self.early or ():
            self.show(message)
        self.early = None

    def close(self, stays: bool = True) -> dict[str, Any]:
        """End the views, and return a summary. A live view's viewer `stays` open. Raises RunFailed if the file could
        not be written.
        """
        summary: dict[str, Any] = {"frames": self.frames, "seconds": self.seconds}
        if self.file is not None:
            file, self.file = self.file, None
            summary |= {"shown": file.bridge.frames, "saved": file.bridge.frames, "file": str(file.finish())}
        if self.live is not None:
            self.live.finish(stays)
            summary |= {"shown": self.live.shown, "skipped": self.live.skipped, "error": self.live.error}
            summary |= {"pid": self.live.pid, "page": self.live.page}
        return summary


def _painter(loaded: Loaded) -> DyePainter | None:
    if loaded.dye is None:
        return None
    from nuno.viewer.dyed import viewer_painter

    return viewer_painter(loaded)


def main(context: Context) -> None:
    """Show one run until asked to finish. Raises BadInput, RunFailed."""
    require(context.options.view, context.options.save)
    viewer = Viewer(context)
    try:
        finish = each_message(context, viewer.inbox, viewer.handle)
        viewer.drain()
    except RunFailed:
        viewer.close(stays=False)
        raise
    finish.answer_json(context.counts(viewer.inbox) | viewer.close())


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


# Writing of rerun files, from messages as they arrive, or from a recording.

FLUSH_SECONDS = 60.0
BLOCK = 2**20
PIPES = Path("/dev/fd")


class RerunFile:
    """Writes `path` + ".part", which is renamed when it is complete.

    run  the recording's id in rerun. Every message given to `feed` is written.

    Raises BadInput if the file cannot be created, RunFailed if writing fails later (disk
    full).
    """

    def __init__(
        self,
        path: Path,
        run: str,
        view: View | None = None,
        images: ReadImage = read_image,
        painter: DyePainter | None = None,
    ) -> None:
        self.path = path
        self._recording = rr.RecordingStream(APPLICATION, recording_id=run, send_properties=False)
        try:
            self._file = part_of(path).open("wb")
        except OSError as error:
            remedy = "choose a folder that exists and can be written"
            raise BadInput(f"cannot write there: {error.strerror}", value=str(path), remedy=remedy) from None
        self._copy = _save(self._recording, self._file)
        self.bridge = Bridge(self._recording, view, images=images, painter=painter)

    def feed(self, topic: str, frame: int, t: float, payload: bytes) -> None:
        """Write one message. Raises BadMessage, RunFailed."""
        self.bridge.feed(topic, frame, t, payload)
        if self._copy is not None and self._copy.error is not None:
            raise self._failed(self._copy.error)

    def abort(self) -> None:
        """Stop writing and delete the file."""
        self._close()
        part_of(self.path).unlink(missing_ok=True)

    def finish(self) -> Path:
        """Write the rest and rename the file. Raises RunFailed if it cannot be written."""
        self.bridge.flush()
        error = self._close()
        if error is not None:
            raise self._failed(error)
        part_of(self.path).replace(self.path)
        return self.path

    def _close(self) -> Exception | None:
        """Flush and close the file, and return the first error."""
        try:
            self._recording.flush(timeout_sec=FLUSH_SECONDS)
            self._recording.disconnect()
            if self._copy is not None:
                self._copy.join(FLUSH_SECONDS)
            self._file.close()
        except (OSError, RuntimeError, ValueError) as error:
            return error
        return self._copy.error if self._copy is not None else None

    def _failed(self, error: Exception) -> RunFailed:
        return RunFailed(f"the rerun file could not be written: {error}; {part_of(self.path)} holds what was")


def _save(recording: rr.RecordingStream, file: BinaryIO) -> _Copy | None:
    """Connect a recording to an open file, through a pipe if the system has /dev/fd.

    rerun's own writer stops silently when the disk is full, and then neither flushing nor
    exiting the program ever ends. So it writes to a pipe, which never fails.
    """
    if not PIPES.is_dir():
        recording.save(file.name)
        return None
    source, sink = os.pipe()
    try:
        recording.save(PIPES / str(sink))
    finally:
        os.close(sink)
    copy = _Copy(source, file)
    copy.start()
    return copy


class _Copy(threading.Thread):
    """Copies a pipe to a file until its end; after an error it keeps reading, and discards the data."""

    def __init__(self, source: int, file: BinaryIO) -> None:
        super().__init__(daemon=True)
        self.error: OSError | None = None
        self._source, self._file = source, file

    def run(self) -> None:
        while block := os.read(self._source, BLOCK):
            if self.error is None:
                try:
                    self._file.write(block)
                except OSError as error:
                    self.error = error
        os.close(self._source)


def convert(recording: Recording, path: Path) -> Path:
    """Write every message of a finished recording to a rerun file. Raises BadInput for a damaged one."""
    run = recording.metadata.get("run", {}).get("id", recording.path.stem)
    try:
        view = View.model_validate(recording.scene.get("view", {}))
    except ValidationError:
        view = View()
    with ExitStack() as stack:
        painter = None
        if recording.scene.get("dye"):  # the scene's files exist within this block
            painter = viewer_painter(stack.enter_context(restored_scene(recording)))
        file = RerunFile(path, run, view, lambda texture: read_texture(recording, texture), painter)
        marks = recording.marks()
        try:
            for message in recording.messages():
                frame, _ = marks.get(message.log_time, (-1, ""))
                file.feed(message.topic, frame, message.t, message.payload)
        except BadMessage as error:
            file.abort()
            raise BadInput(f"a message cannot be read: {error}", str(recording.path)) from None
        return file.finish()
