"""Writing of rerun files, from messages as they arrive, or from a recording."""

from __future__ import annotations

import os
import threading
from contextlib import ExitStack
from pathlib import Path
from typing import BinaryIO

import rerun as rr
from pydantic import ValidationError

from nuno.bus.encodings import BadMessage
from nuno.dye.painter import DyePainter
from nuno.exports.cloth import read_texture
from nuno.recording.reader import Recording
from nuno.recording.writer import part_of
from nuno.scene.recorded_scene import restored_scene
from nuno.viewer.bridge import Bridge
from nuno.viewer.cloth import ReadImage, read_image
from nuno.viewer.dyed import viewer_painter
from nuno.viewer.stream import APPLICATION, application
from nuno_schemas.errors import BadInput, RunFailed
from nuno_schemas.scene import View

FLUSH_SECONDS = 60.0
BLOCK = 2**20
PIPES = Path("/dev/fd")


class RerunFile:
    """Writes `path` + ".part", which is renamed when it is complete.

    run     the recording's id in rerun. Every message given to `feed` is written.
    layout  its application id

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
        layout: str = APPLICATION,
        colour: str = "auto",
    ) -> None:
        self.path = path
        self._recording = rr.RecordingStream(layout, recording_id=run, send_properties=False)
        try:
            self._file = part_of(path).open("wb")
        except OSError as error:
            remedy = "choose a folder that exists and can be written"
            raise BadInput(f"cannot write there: {error.strerror}", value=str(path), remedy=remedy) from None
        self._copy = _save(self._recording, self._file)
        self.bridge = Bridge(self._recording, view, images=images, painter=painter, colour=colour)

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


def convert(recording: Recording, path: Path, colour: str = "auto") -> Path:
    """Write every message of a finished recording to a rerun file, with all cloth painted by `colour`: cloth,
    stretch, or auto, as the scene's view says. Raises BadInput for a damaged recording.
    """
    run = recording.metadata.get("run", {}).get("id", recording.path.stem)
    try:
        view = View.model_validate(recording.scene.get("view", {}))
    except ValidationError:
        view = View()
    with ExitStack() as stack:
        painter = None
        if recording.scene.get("dye"):  # the scene's files exist within this block
            painter = viewer_painter(stack.enter_context(restored_scene(recording)))
        layout = application(recording.scene)
        file = RerunFile(path, run, view, lambda texture: read_texture(recording, texture), painter, layout, colour)
        try:
            for message in recording.messages():
                file.feed(message.topic, recording.mark(message)[0], message.t, message.payload)
        except BadMessage as error:
            file.abort()
            raise BadInput(f"a message cannot be read: {error}", str(recording.path)) from None
        return file.finish()
