"""Writing of rerun files, from messages as they arrive, or from a recording."""

from __future__ import annotations

import os
import threading
from collections.abc import Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import BinaryIO, Self

import psutil
import rerun as rr
from pydantic import ValidationError

from nuno.bus.encodings import BadMessage
from nuno.dye.painter import DyePainter
from nuno.exports.cloth import Pieces, read_texture
from nuno.output_files import Progress, following
from nuno.recording.reader import Recording
from nuno.recording.writer import part_of
from nuno.scene.recorded_scene import restored_scene
from nuno.viewer.bridge import Bridge
from nuno.viewer.cloth import ReadImage, field_values, read_image
from nuno.viewer.dyed import viewer_painter
from nuno.viewer.fields import Scale, require_field
from nuno.viewer.live import VIEWS
from nuno.viewer.stream import OpenViewer, Subject, application, connect, describe, find_viewer, properties
from nuno_schemas.errors import BadInput, RunFailed
from nuno_schemas.messages import STATE
from nuno_schemas.scene import View

FLUSH_SECONDS = 60.0
BLOCK = 2**20
SAMPLES = 32
"""Most frames whose values the colour scales of a recording are fitted to before."""
PIPES = Path("/dev/fd")


class RrdFile:
    """A rerun recording stream, `recording`, that is written to `path` + ".part", which is renamed when it is complete.

    Raises BadInput if the file cannot be created, RunFailed if writing fails later (disk full).
    """

    def __init__(self, path: Path, subject: Subject) -> None:
        self.path = path
        self.recording = rr.RecordingStream(subject.layout, recording_id=subject.run, send_properties=False)
        try:
            self._file = part_of(path).open("wb")
        except OSError as error:
            remedy = "choose a folder that exists and can be written"
            raise BadInput(f"cannot write there: {error.strerror}", value=str(path), remedy=remedy) from None
        self._copy: _Copy | None = None
        try:
            self._copy = _save(self.recording, self._file)
            self.recording.set_log_time_enabled(False)  # two conversions of one recording are equal
            self.recording.set_log_tick_enabled(False)
            describe(self.recording, subject)
        except BaseException:  # an interrupt, too
            self.abort()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        """Delete the file if it was left before it was finished by any error, an interrupt too."""
        if kind is not None:
            self.abort()

    def check(self) -> None:
        """Raise RunFailed if writing has failed."""
        if self._copy is not None and self._copy.error is not None:
            raise self._failed(self._copy.error)

    def abort(self) -> None:
        """Stop writing and delete the file."""
        self._close()
        part_of(self.path).unlink(missing_ok=True)

    def finish(self) -> Path:
        """Write the rest and rename the file. Raises RunFailed if it cannot be written."""
        error = self._close()
        if error is not None:
            raise self._failed(error)
        part_of(self.path).replace(self.path)
        return self.path

    def _close(self) -> Exception | None:
        """Flush and close the file, and return the first error."""
        try:
            self.recording.flush(timeout_sec=FLUSH_SECONDS)
            self.recording.disconnect()
            if self._copy is not None:
                self._copy.join(FLUSH_SECONDS)
            self._file.close()
        except (OSError, RuntimeError, ValueError) as error:
            return error
        return self._copy.error if self._copy is not None else None

    def _failed(self, error: Exception) -> RunFailed:
        return RunFailed(f"the rerun file could not be written: {error}; {part_of(self.path)} holds what was")


class RerunFile(RrdFile):
    """Writes every message given to `feed`, as Bridge shows it; `images`, `painter` and `colour` are Bridge's."""

    def __init__(
        self,
        path: Path,
        subject: Subject,
        images: ReadImage = read_image,
        painter: DyePainter | None = None,
        colour: str = "auto",
    ) -> None:
        super().__init__(path, subject)
        self.bridge = Bridge(self.recording, subject.view, images=images, painter=painter, colour=colour)

    def feed(self, topic: str, frame: int, t: float, payload: bytes) -> None:
        """Write one message. Raises BadMessage, RunFailed."""
        self.bridge.feed(topic, frame, t, payload)
        self.check()

    def finish(self) -> Path:
        """Write the rest and rename the file. Raises RunFailed if it cannot be written."""
        self.bridge.flush()
        return super().finish()


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


def subject_of(recording: Recording) -> Subject:
    """Return what a recording shows; a damaged view is the default one."""
    try:
        view = View.model_validate(recording.scene.get("view", {}))
    except ValidationError:
        view = View()
    run = recording.metadata.get("run", {}).get("id", recording.path.stem)
    facts = properties(recording.scene, recording.metadata.get("versions", {}))
    return Subject(run=run, view=view, layout=application(recording.scene), properties=facts)


def recorded_painter(recording: Recording, stack: ExitStack) -> DyePainter | None:
    """Return the painter of a recording's dye, if any; the scene's files exist until the stack is closed."""
    return viewer_painter(stack.enter_context(restored_scene(recording))) if recording.scene.get("dye") else None


def measure_scales(recording: Recording, scales: Mapping[str, Scale]) -> None:
    """Widen colour scales to the values of a recording, at most SAMPLES frames of it. Raises BadInput."""
    count = recording.counts.get(STATE.name, 0)
    every, pieces = max(1, -(-count // SAMPLES)), Pieces(recording)
    for i, message in enumerate(recording.messages([STATE.name])):
        if i % every == 0:
            positions = recording.points(message)
            for piece in pieces.at(message.t):
                if piece.stop <= len(positions):
                    for name, values in field_values(piece, positions[piece.start : piece.stop]):
                        scales[name].widen(values)


def convert(recording: Recording, path: Path, colour: str = "auto", progress: Progress | None = None) -> Path:
    """Write every message of a finished recording to a rerun file, in which cloth is seen first by `colour`: cloth, a
    field, or auto, as the scene's view says. `progress` is called with the messages done and in all. Raises BadInput
    for a damaged recording, and for a field that it does not have.
    """
    with ExitStack() as stack:
        painter, subject = recorded_painter(recording, stack), subject_of(recording)
        file = stack.enter_context(
            RerunFile(path, subject, lambda name: read_texture(recording, name), painter, colour)
        )
        measure_scales(recording, file.bridge.scales)
        try:
            for message in following(recording.messages(), sum(recording.counts.values()), progress):
                file.feed(message.topic, recording.mark(message)[0], message.t, message.payload)
        except BadMessage as error:
            raise BadInput(f"a message cannot be read: {error}", str(recording.path)) from None
        require_field(colour, file.bridge.window.fields)
        return file.finish()


def show_file(path: Path, subject: Subject, view: str) -> OpenViewer:
    """Send a rerun file to a viewer, "window", "web" or an address, and return the viewer. Raises RunFailed if there is
    none.
    """
    try:
        viewer = find_viewer(view) if view in VIEWS else OpenViewer(0, view, "", reused=True)
        stream = connect(viewer.address, subject)
        stream.log_file_from_path(path)
        stream.flush(timeout_sec=FLUSH_SECONDS)
        stream.disconnect()
    except (OSError, RuntimeError, ValueError, psutil.Error) as error:
        raise RunFailed(f"the viewer does not show it: {error}") from None
    return viewer
