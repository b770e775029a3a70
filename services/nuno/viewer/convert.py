"""A finished recording as a file for the rerun viewer."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from pydantic import ValidationError

from nuno.dye.painter import DyePainter
from nuno.export.cloth import read_texture
from nuno.recording.reader import Recording
from nuno.recording.restore import restored_scene
from nuno.viewer.dyed import viewer_painter
from nuno.viewer.file import RerunFile
from nuno.wire.arrays import BadMessage
from nuno_schemas.errors import BadInput
from nuno_schemas.view import View


def convert(recording: Recording, path: Path) -> Path:
    """Write every message of a recording to a rerun file. Raises BadInput for a damaged one."""
    run = recording.metadata.get("run", {}).get("id", recording.path.stem)
    try:
        view = View.model_validate(recording.scene.get("view", {}))
    except ValidationError:
        view = View()
    with _painter(recording) as painter:
        file = RerunFile(path, run, view, lambda texture: read_texture(recording, texture), painter)
        return _write(recording, file)


@contextmanager
def _painter(recording: Recording) -> Iterator[DyePainter | None]:
    """What draws the recording's dyed cloth, while its scene's files are there."""
    if not recording.scene.get("dye"):
        yield None
        return
    with restored_scene(recording) as loaded:
        yield viewer_painter(loaded)


def _write(recording: Recording, file: RerunFile) -> Path:
    marks = recording.marks()
    try:
        for message in recording.messages():
            frame, _ = marks.get(message.log_time, (-1, ""))
            file.feed(message.topic, frame, message.t, message.payload)
    except BadMessage as error:
        file.abort()
        raise BadInput(f"a message cannot be read: {error}", str(recording.path)) from None
    return file.finish()
