"""A simulation that goes on from a checkpoint."""

from __future__ import annotations

from nuno.recording.reader import Recording
from nuno.recording.recorded import Checkpoint
from nuno.recording.restore import control_events
from nuno.simulation.run import Simulation


def take_up(simulation: Simulation, recording: Recording, point: Checkpoint) -> None:
    """Bring a simulation that has not begun to a checkpoint of a recording of its scene, with what was set until then.

    Raises BadInput where the checkpoint does not fit.
    """
    for event in control_events(recording):
        if event.text == "set" and event.frame <= point.frame:
            simulation.set(str(event.args["item"]))
    simulation.adopt(point.fabric, point.text)
    simulation.resume(point.frame, point.x, point.v, point.memory)
