"""The scene of a recording, with its files, to run it again or to resume it."""

from __future__ import annotations

import json
import math
import shlex
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from nuno.process import scratch
from nuno.recording.reader import END, NOTHING, Recording, open_recording, recorded_poses, settled_cloth, shortcoming
from nuno.recording.writer import topic_of
from nuno.scene import scene_file
from nuno.scene.override import SETTABLE, parts_of
from nuno.scene.scene_file import Loaded
from nuno_schemas.errors import BadInput, nearest
from nuno_schemas.messages import FRAMES
from nuno_schemas.scene import Scene

RESUMABLE = ("duration", "record", "view")
"""Fields that may change on resuming: with any other, the recording could not be simulated again."""


@contextmanager
def restored_scene(recording: Recording, overrides: tuple[str, ...] = ()) -> Iterator[Loaded]:
    """Load the scene of a recording, with its files unpacked into a temporary folder.

    Raises BadInput where the recording has no scene, or one that this version refuses.
    """
    data = recording.scene
    if not data:
        raise BadInput("the recording holds no scene", str(recording.path), remedy="give the scene it was made from")
    with scratch() as base:
        for name in recording.attachments:
            try:
                target = (base / name).resolve()
                if not target.is_relative_to(base.resolve()):
                    raise BadInput("a file in the recording lies outside its folder", str(recording.path), value=name)
                target.parent.mkdir(parents=True, exist_ok=True)
                target.write_bytes(recording.attachment(name))
            except (OSError, ValueError) as error:  # no name, one that is too long, or that of a folder
                problem = f"a file in the recording cannot be unpacked: {getattr(error, 'strerror', None) or error}"
                raise BadInput(problem, str(recording.path), value=name) from None
        scene = base / "scene.yaml"  # JSON is YAML; services in separate processes read it, too
        scene.write_text(json.dumps(data))
        loaded = scene_file.read(scene, overrides, named=f"the scene in {recording.path}")
        loaded.settled, loaded.recorded_sizes = settled_cloth(recording), recorded_sizes(recording)
        if loaded.live:
            loaded.recorded_poses = recorded_poses(recording)
        yield loaded


def recorded_sizes(recording: Recording) -> dict[str, int]:
    """Return `Loaded.recorded_sizes` of a recording."""
    state, amounts = (next(recording.messages([topic]), None) for topic in FRAMES)
    phi = recording.arrays(amounts)[0].get("phi", np.zeros(0))
    sizes = {"cells": 2 * math.prod(phi.shape[-2:])} if phi.size else {}
    return sizes if state is None else sizes | {"vertices": len(recording.points(state))}


@contextmanager
def resumed_scene(path: Path, overrides: Sequence[str]) -> Iterator[tuple[Loaded, str]]:
    """Load the scene of a recording to resume it; yield it and a text about it. Raises BadInput for a fixed field."""
    for item in overrides:
        field = parts_of(item.partition("=")[0])[0]
        if field not in Scene.model_fields:
            raise BadInput("no such field", "--set", field=field, remedy=nearest(field, RESUMABLE))
        if field not in RESUMABLE:
            problem, limit = "this field cannot change when a run goes on from a checkpoint", ", ".join(RESUMABLE)
            export = f"nuno export {shlex.quote(str(path))} --scene own.yaml"
            remedy = f"run its scene anew: {export}; nuno run own.yaml --set ..."
            if field in SETTABLE:
                remedy = f"change it while the run goes on: nuno control last set {shlex.quote(item)}"
            raise BadInput(problem, "--set", field=field, value=item, limit=limit, remedy=remedy)
    with open_recording(path) as recording:
        if recording.damage and END in recording.metadata:
            remedy = "take another copy; nuno replay, export and verify read its frames"
            raise BadInput(f"{recording.damage}: its scene may be another", str(path), remedy=remedy)
        with restored_scene(recording, tuple(overrides)) as loaded:
            t = check_unfinished(recording, loaded)
            reason = shortcoming(recording, NOTHING)
            yield loaded, f"going on at {t:g} s of {path}{reason and f' ({reason})'}"


def check_unfinished(recording: Recording, loaded: Loaded) -> float:
    """Return the time at which a recording's run can resume [s]. Raises BadInput if it cannot, or is complete."""
    if unknown_topics := [topic for topic in recording.counts if topic_of(topic) is None]:
        problem, remedy = "a run cannot go on with a topic that none records", "write the recording anew without it"
        raise BadInput(problem, str(recording.path), value=unknown_topics[0], remedy=remedy)
    t = recording.common_checkpoint().t
    frame, frames = round(t * loaded.scene.frame_rate), loaded.scene.frames
    if frame > frames or (frame == frames and recording.complete):
        problem = "the run has come to the end of its scene" if frame == frames else "the recording goes on after that"
        raise BadInput(
            problem,
            str(recording.path),
            field="duration",
            value=f"{loaded.scene.duration:g} s",
            limit=f"its last checkpoint is at {t:g} s",
            remedy=f"lengthen it, for example --set duration={2 * t:g}s",
        )
    return t
