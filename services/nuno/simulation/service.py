"""The simulation service: prepares a run and lets its driver go through the frames."""

from __future__ import annotations

from pathlib import Path

from nuno.collision.ask import ask_geometry, ask_poses
from nuno.service import Context
from nuno.simulation.driver import Driver
from nuno.simulation.run import Simulation
from nuno_schemas.bodies import Poses
from nuno_schemas.errors import BadInput


def resume(context: Context, simulation: Simulation, path: Path, poses: Poses | None) -> Poses | None:
    """Go on from a recording's last checkpoint, with what was set before it; the poses there."""
    from nuno.recording.reader import open_recording
    from nuno.simulation.resume import take_up

    with open_recording(path) as recording:
        point = recording.last_checkpoint(recording.common_checkpoint().t)
        frames = context.loaded.scene.frames
        if point.frame > frames:
            raise BadInput(
                "the recording goes on after the end of the scene",
                str(path),
                value=f"frame {point.frame}",
                limit=f"{frames} frames",
                remedy="lengthen the scene, for example --set duration=10s",
            )
        take_up(simulation, recording, point)
    return ask_poses(context, point.frame)() if poses is not None else None


def main(context: Context) -> None:
    """Simulate one run: prepare, wait for the start, step through the frames, answer the end."""
    geometry = ask_geometry(context) if context.loaded.scene.bodies else None
    poses = ask_poses(context, 0)() if geometry is not None else None
    simulation = Simulation(context.loaded, geometry, poses, context.options.threads)
    if context.options.resume is not None:
        poses = resume(context, simulation, context.options.resume, poses)
    simulation.measure(poses)  # compiles what the steps need, so that the run itself is timed without it
    simulation.rehearse(poses)
    Driver(context, simulation, poses).serve()
