"""Re-simulates a recording and compares it, frame by frame, to the last bit."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from nuno import build
from nuno.recording.reader import Recording
from nuno.recording.restore import control_events, restored_scene
from nuno.scene_file import Loaded
from nuno.simulation.run import Simulation
from nuno_schemas.errors import BadInput
from nuno_schemas.messages import DYE_STATUS, STATUS, Event


@dataclass(frozen=True)
class Verification:
    """What a comparison found.

    compared is the number of frames whose digests were compared, of a dyed garment the cloth's, and dyed that of
    its dye; frame the first one that
    differs (None: all are equal), and difference says where, if a checkpoint of that frame or a
    later one allows to tell.
    """

    compared: int
    frame: int | None = None
    t: float = 0.0
    difference: str = ""
    dyed: int = 0


def verify(recording: Recording, threads: int = 0, progress: Callable[[float], None] | None = None) -> Verification:
    """Simulate a recording's scene again, with its control events, and compare every digest.

    Raises BadInput for a recording without scene or digests.
    """
    with restored_scene(recording) as loaded:
        found = Verification(0)
        if loaded.scene.moves:
            found = verify_cloth(recording, loaded, _digests(recording, STATUS.name), threads, progress)
        if found.frame is not None or loaded.dye is None:
            return found
        from nuno.dye.verify import verify_dye

        dyed = verify_dye(recording, loaded, _digests(recording, DYE_STATUS.name), threads, progress)
        return replace(dyed, compared=found.compared, dyed=dyed.compared) if loaded.scene.moves else dyed


def _digests(recording: Recording, status: str) -> dict[int, str]:
    """Digests by frame. Raises BadInput where there are none."""
    wanted = {number: digest for number, digest in recording.marks(status).values() if digest}
    if not wanted:
        raise BadInput("the recording holds no digests to compare", str(recording.path))
    return wanted


def verify_cloth(
    recording: Recording,
    loaded: Loaded,
    wanted: Mapping[int, str],
    threads: int,
    progress: Callable[[float], None] | None,
) -> Verification:
    """Simulate again, and compare every digest in `wanted`, by frame. Raises BadInput."""
    checkpoints = {point.frame: point.x for point in recording.checkpoints()}
    changes = [event for event in control_events(recording) if event.text in ("set", "add")]
    bodies = build.build_bodies(loaded) if loaded.scene.bodies else None
    rate = loaded.scene.frame_rate
    start = bodies.poses(0.0) if bodies else None
    simulation = Simulation(loaded, bodies.geometry if bodies else None, start, threads)
    simulation.measure(start)
    for compared, frame in enumerate(range(max(wanted) + 1)):
        if frame:
            _change(simulation, changes, frame - 1)
            end = bodies.poses(frame / rate) if bodies else None
            simulation.advance(start, end)
            start = end
        if frame in wanted and simulation.digest() != wanted[frame]:
            # A change made before the first frame, of this run or of a resumed one, is in that frame already.
            _change(simulation, changes, frame)
        if frame in wanted and simulation.digest() != wanted[frame]:
            return Verification(compared, frame, simulation.t, _explain(simulation, checkpoints.get(frame)))
        if progress is not None:
            progress(simulation.t)
    return Verification(len(wanted))


def _change(simulation: Simulation, changes: list[Event], frame: int) -> None:
    """Make the changes of a frame, each once, in their order; those of dye are not the cloth's."""
    for event in [event for event in changes if event.frame == frame]:
        changes.remove(event)
        item = str(event.args["item"])
        if event.text == "set":
            simulation.set(item)
        elif event.service == "simulation":
            simulation.add(item)


def _explain(simulation: Simulation, recorded: np.ndarray | None) -> str:
    if recorded is not None and recorded.shape != simulation.state.x.shape:
        return f"{len(simulation.state.x)} vertices, and the recording has {len(recorded)}"
    if recorded is None:
        return "positions or velocities differ; the recording has no checkpoint of that frame to say where"
    apart = np.abs(simulation.state.x - recorded).max(axis=1)
    vertex = int(np.argmax(apart))
    if apart[vertex] == 0.0:
        return "positions are equal, velocities differ"
    return f"vertex {vertex} lies {apart[vertex]:.3g} m away"
