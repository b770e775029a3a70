"""The dye of a recording, spread again."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from nuno.dye.checkpoint import additions, read_checkpoint
from nuno.dye.run import DyeRun
from nuno.recording.reader import Recording
from nuno.recording.recorded import Arrays, Recorded
from nuno.scene.scene_file import Loaded
from nuno.verify import Again, remembered
from nuno.wire.arrays import decode_arrays
from nuno_schemas.messages import CONCENTRATION, DYE_CHECKPOINT, DYE_STATUS

MOBILE, FIXED = "mobile dye", "fixed dye"


class DyeAgain(Again):
    """A dyeing with what was added to that of a recording."""

    part = "dye"
    status, published, checkpoint = DYE_STATUS.name, CONCENTRATION.name, DYE_CHECKPOINT.name

    def __init__(self, recording: Recording, loaded: Loaded, threads: int, start: Recorded | None = None) -> None:
        """From a checkpoint's message on, or else from the start. Raises BadInput."""
        self.additions = additions(recording)
        """Still to be made."""
        self.dyeing = DyeRun(loaded, threads)
        self._recording = recording
        if start is not None:
            point = read_checkpoint(recording, start)
            self.dyeing.resume(point, [one for one in self.additions if one[0] <= point.frame])
            self.additions = [one for one in self.additions if one[0] > point.frame]

    @property
    def frame(self) -> int:
        """See `Again`."""
        return self.dyeing.frame

    @property
    def t(self) -> float:
        """See `Again`."""
        return self.dyeing.t

    def go_to(self, frame: int) -> None:
        """See `Again`."""
        while self.frame < frame:
            self.change()
            self.dyeing.advance()

    def change(self) -> None:
        """See `Again`; each addition once, in their order."""
        for one in [one for one in self.additions if one[0] == self.frame]:
            self.additions.remove(one)
            self.dyeing.add(one[1])

    @property
    def changing(self) -> bool:
        """See `Again`."""
        return any(frame == self.frame for frame, _ in self.additions)

    def digest(self) -> str:
        """See `Again`."""
        return self.dyeing.digest()

    def arrays(self) -> Arrays:
        """See `Again`."""
        amounts = {MOBILE: self.dyeing.state.phi, FIXED: self.dyeing.state.fixed}
        return amounts | remembered(self.dyeing.memory.arrays)

    def shown(self, payload: bytes) -> tuple[Arrays, Arrays]:
        """See `Again`."""
        state = self.dyeing.state
        ours = {name: amounts.astype(np.float32) for name, amounts in ((MOBILE, state.phi), (FIXED, state.fixed))}
        arrays, _ = decode_arrays(payload)
        return ours, {MOBILE: arrays["phi"], FIXED: arrays["fixed"]}

    def kept(self, message: Recorded) -> tuple[str, Arrays]:
        """See `Again`."""
        point = read_checkpoint(self._recording, message)
        return point.digest, {MOBILE: point.phi, FIXED: point.fixed} | remembered(point.memory)

    def name(self, quantity: str, index: Sequence[int]) -> str:
        """See `Again`."""
        dye, layer, row, column = index
        return f"{self.dyeing.names[dye]} in the {('weft', 'warp')[layer]} of cell ({column}, {row})"
