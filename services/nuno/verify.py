"""Re-simulates a recording and compares it, frame by frame, to the last bit."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from nuno import build
from nuno.recording.reader import Recording
from nuno.recording.restore import control_events, restored_scene
from nuno.simulation.run import Simulation
from nuno_schemas.errors import BadInput


@dataclass(frozen=True)
class Verification:
    """What a comparison found.

    compared is the number of frames whose digests were compared; frame the first one that
    differs (None: all are equal), and difference says where, if a checkpoint of that frame or a
    later one allows to tell.
    """

    compared: int
    frame: int | None = None
    t: float = 0.0
    difference: str = ""


def verify(recording: Recording, threads: int = 0, progress: Callable[[float], None] | None = None) -> Verification:
    """Simulate a recording's scene again, with its control events, and compare every digest.

    Raises BadInput for a recording without scene or digests.
    """
    wanted = {number: digest for number, digest in recording.marks().values() if digest}
    if not wanted:
        raise BadInput("the recording holds no digests to compare", str(recording.path))
    checkpoints = {point.frame: point.x for point in recording.checkpoints()}
    changes = [event for event in control_events(recording) if event.text == "set"]
    with restored_scene(recording) as loaded:
        if loaded.dye is not None:
            from nuno.dye.verify import verify_dye

            return verify_dye(recording, loaded, wanted, threads, progress)
        bodies = build.build_bodies(loaded) if loaded.scene.bodies else None
        rate = loaded.scene.frame_rate
        start = bodies.poses(0.0) if bodies else None
        simulation = Simulation(loaded, bodies.geometry if bodies else None, start, threads)
        simulation.measure(start)
        for compared, frame in enumerate(range(max(wanted) + 1)):
            if frame:
                for event in changes:
                    if event.frame == frame - 1:
                        simulation.set(str(event.args["item"]))
                end = bodies.poses(frame / rate) if bodies else None
                simulation.advance(start, end)
                start = end
            if frame in wanted and simulation.digest() != wanted[frame]:
                return Verification(compared, frame, simulation.t, _explain(simulation, checkpoints.get(frame)))
            if progress is not None:
                progress(simulation.t)
    return Verification(len(wanted))


def _explain(simulation: Simulation, recorded: np.ndarray | None) -> str:
    if recorded is None:
        return "positions or velocities differ; the recording has no checkpoint of that frame to say where"
    apart = np.abs(simulation.state.x - recorded).max(axis=1)
    vertex = int(np.argmax(apart))
    if apart[vertex] == 0.0:
        return "positions are equal, velocities differ"
    return f"vertex {vertex} lies {apart[vertex]:.3g} m away"
