"""Spreads the dye of a recording again and compares it, frame by frame, to the last bit."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from nuno.dye.checkpoint import DyeCheckpoint, additions, read_checkpoints
from nuno.dye.run import DyeRun
from nuno.recording.reader import Recording
from nuno.scene_file import Loaded
from nuno.verify import Verification


def verify_dye(
    recording: Recording,
    loaded: Loaded,
    wanted: Mapping[int, str],
    threads: int,
    progress: Callable[[float], None] | None,
) -> Verification:
    """Compare every digest in `wanted`, by frame. Raises BadInput."""
    checkpoints = {point.frame: point for point in read_checkpoints(recording)}
    added = additions(recording)
    dyeing = DyeRun(loaded, threads)
    compared = 0
    for frame in range(max(wanted) + 1):
        if frame:
            for at, item in added:
                if at == frame - 1:
                    dyeing.add(item)
            dyeing.advance()
        if frame in wanted:
            if dyeing.digest() != wanted[frame]:
                return Verification(compared, frame, dyeing.t, _explain(dyeing, checkpoints.get(frame)))
            compared += 1
        if progress is not None:
            progress(dyeing.t)
    return Verification(compared)


def _explain(dyeing: DyeRun, recorded: DyeCheckpoint | None) -> str:
    if recorded is None:
        return "amounts of dye differ; the recording has no checkpoint of that frame to say where"
    for name, amount in (("mobile", recorded.phi), ("fixed", recorded.fixed)):
        apart = np.abs((dyeing.state.phi if name == "mobile" else dyeing.state.fixed) - amount)
        if apart.any():
            index = tuple(int(i) for i in np.unravel_index(int(np.argmax(apart)), apart.shape))
            return f"{name} dye differs by {apart[index]:.3g} in cell {index[1:]} of {dyeing.names[index[0]]}"
    return "the checkpoint holds the same amounts, but not those of its frame"
