"""A recording's own scene, with the files it used, ready to run again."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from pydantic import ValidationError

from nuno import scene_file
from nuno.files import SceneFiles
from nuno.recording.reader import Recording
from nuno.scene_file import Loaded
from nuno_schemas.errors import BadInput
from nuno_schemas.messages import EVENT, Event


def control_events(recording: Recording) -> list[Event]:
    """What a user did to the run while it went on, in order: pause, resume, step, stop, set."""
    found = []
    for message in recording.messages([f"{EVENT.name}/simulation"]):
        try:
            event = Event.model_validate_json(message.payload)
        except ValidationError as error:
            raise BadInput("an event in the recording cannot be read", str(recording.path), value=str(error)) from None
        if event.kind == "control":
            found.append(event)
    return found


@contextmanager
def restored_scene(recording: Recording, overrides: tuple[str, ...] = ()) -> Iterator[Loaded]:
    """The scene as it was run, its files unpacked into a folder of their own meanwhile.

    Raises BadInput where the recording holds no scene, or one that this version refuses.
    """
    data = recording.scene
    if not data:
        raise BadInput("the recording holds no scene", str(recording.path), remedy="give the scene it was made from")
    with tempfile.TemporaryDirectory(prefix="nuno-") as folder:
        base = Path(folder)
        for name in recording.attachments:
            target = (base / name).resolve()
            if not target.is_relative_to(base.resolve()):
                raise BadInput("a file in the recording lies outside its folder", str(recording.path), value=name)
            target.parent.mkdir(parents=True, exist_ok=True)
            target.write_bytes(recording.attachment(name))
        for item in overrides:
            scene_file.apply_override(data, item)
        yield scene_file.load(data, {}, str(recording.path), SceneFiles(base))
