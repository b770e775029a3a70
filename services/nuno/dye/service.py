"""The dye service: prepares a run and lets its driver go through the frames."""

from __future__ import annotations

from pathlib import Path

from nuno.dye.checkpoint import additions, last_checkpoint
from nuno.dye.driver import Driver
from nuno.dye.run import DyeRun
from nuno.recording.reader import open_recording
from nuno.service import Context
from nuno_schemas.errors import BadInput


def resume(dyeing: DyeRun, path: Path) -> None:
    """Go on from a recording's last checkpoint, with what was added before it."""
    with open_recording(path) as recording:
        before = recording.common_checkpoint().t
        point, frames = last_checkpoint(recording, before), dyeing.loaded.scene.frames
        if point.frame > frames:
            raise BadInput(
                "the recording goes on after the end of the scene",
                str(path),
                value=f"frame {point.frame}",
                limit=f"{frames} frames",
                remedy="lengthen the scene, for example --set duration=10s",
            )
        dyeing.resume(point, [one for one in additions(recording) if one[0] <= point.frame])


def main(context: Context) -> None:
    """Spread the dye of one run: prepare, step through the frames from the start on, answer the end."""
    dyeing = DyeRun(context.loaded, context.options.threads)
    if context.options.resume is not None:
        resume(dyeing, context.options.resume)
    Driver(context, dyeing).serve()
