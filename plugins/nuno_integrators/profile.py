"""The cost of each part of a step, found by leaving it out."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from nuno_integrators.packing import copy_terms, making_lists, parts, silence
from nuno_kernels.step.acceleration import Extra, Packed, call_each
from nuno_schemas.fabric import Float

REPEATS = 5
"""repeats of each variant; the fastest counts, since other programs can only slow it down"""

LONG = 8e-3
"""time [s] that steps are run for together, so that entering the kernel and a method's extra work at an interval's end
do not show"""

BRIEF = 1e-200
"""duration of a step [s] that moves nothing by more than rounding hides, and yet is not 0, at which loops of one pass
leave forces in place of positions"""

MOST = 64
"""most steps run together"""


def profile_steps(loop: Any, packed: Packed, x: Float, v: Float, stages: Float, extra: Extra) -> Mapping[str, float]:
    """Return the seconds per step by part: the names of its terms, and "python" for forces written in Python. The rest
    of a step is attachments, gravity, the update.

    Steps of hardly any duration leave x and v (3, n) where they are, and the loop is the one that the run compiled,
    over tuples of the same types, so nothing is compiled for it. A part's cost is what a step saves without it. Anchors
    are those of a copy. Terms that make lists do so as far as vertices move: such steps do not measure those, which are
    left out.
    """
    lists = making_lists(packed)
    packed_copy = silence(copy_terms(packed), *lists)
    place, speed = x.copy(), v.copy()

    def run(variant: Packed, force: Extra, steps: int) -> float:
        call_each(variant, "begin", place, steps * BRIEF, variant.threads)
        began = time.perf_counter()
        loop(place, speed, stages, steps, BRIEF, variant, force)
        return (time.perf_counter() - began) / steps

    steps = max(1, min(MOST, int(LONG / max(run(packed_copy, extra, 1), 1e-9))))
    variants: dict[str, tuple[Packed, Callable[..., None] | None]] = {"": (packed_copy, extra)}
    for part in parts(packed):
        if part not in lists:
            variants[part] = (silence(packed_copy, part), extra)
    if extra is not None:
        variants["python"] = (packed_copy, lambda x, v, s, a: None)
    # Round by round, so that a disturbance affects all variants alike.
    rounds = [[run(variant, force, steps) for variant, force in variants.values()] for _ in range(REPEATS)]
    whole, *without = np.min(rounds, axis=0).tolist()
    return {part: max(0.0, whole - rest) for part, rest in zip(list(variants)[1:], without, strict=True)}
