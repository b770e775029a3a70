"""Engines that work, crash, hang, raise and talk, for processes that test_bench_peers starts."""

from __future__ import annotations

import os
import signal
import time

import numpy as np

from nuno_bench.peers.pile import Pile
from nuno_bench.peers.problem import Sheet
from nuno_bench.peers.skirt import Skirt
from nuno_schemas.fabric import Float


class Still:
    """Leaves the sheet where it is, moved by `shift` [m] upwards; it talks while it works."""

    def __init__(self, sheet: Sheet, shift: float) -> None:
        print("an engine's own line")
        self.sheet, self.shift, self.remark = sheet, shift, "it did nothing"

    def reset(self) -> None:
        pass

    def advance(self, seconds: float) -> Float:
        time.sleep(0.01 * seconds)
        return self.sheet.x + np.array([0.0, self.shift, 0.0])


class Later(Still):
    """Works until it has been asked `after` times, counted from 0; the first time is the short one."""

    def __init__(self, sheet: Sheet, after: float) -> None:
        super().__init__(sheet, 0.0)
        self.left = after

    def advance(self, seconds: float) -> Float:
        if self.left <= 0:
            self.break_down()
        self.left -= 1
        return self.sheet.x

    def break_down(self) -> None: ...


class Crash(Later):
    def break_down(self) -> None:
        os.kill(os.getpid(), signal.SIGSEGV)


class Hang(Later):
    def break_down(self) -> None:
        time.sleep(600.0)


class Diverge(Still):
    def advance(self, seconds: float) -> Float:
        return np.full_like(self.sheet.x, np.nan)


class Refuse(Still):
    def advance(self, seconds: float) -> Float:
        raise RuntimeError("unstable at step 7")


class Sinks:
    """Frames of a pile whose last vertex is `depth` [m] lower in the second than where it starts."""

    def __init__(self, pile: Pile, depth: float) -> None:
        self.pile, self.depth, self.remark = pile, depth, ""

    def reset(self) -> None:
        pass

    def advance(self, seconds: float) -> Float:
        frames = np.stack([self.pile.x, self.pile.x])
        frames[1, -1, 1] -= self.depth
        return frames


class Drifts:
    """Frames of a skirt that lies `by` [m] higher than where it starts."""

    def __init__(self, skirt: Skirt, by: float) -> None:
        self.skirt, self.by, self.remark = skirt, by, ""

    def reset(self) -> None:
        pass

    def advance(self, seconds: float) -> Float:
        return np.tile(self.skirt.x + np.array([0.0, self.by, 0.0]), (self.skirt.frames, 1, 1))
