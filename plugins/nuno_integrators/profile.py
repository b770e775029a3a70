"""What each part of a step costs, found by leaving it out."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from nuno_kernels.step.acceleration import Extra, Packed
from nuno_kernels.step.packing import call_each, making_lists, own_terms, parts, silence
from nuno_schemas.fabric import Float

REPEATS = 5
"""Each variant is timed this often; the fastest counts, since other programs can only slow it down."""

LONG = 8e-3
"""Steps are run together until they take this long [s]: entering the kernel does not show, nor what a method does once
more at an interval's end.
"""

BRIEF = 1e-200
"""Duration of a step [s] that moves nothing by more than rounding hides, and yet is none of no duration, in which
loops of one pass leave forces where positions go."""

MOST = 64
"""Steps run together at most."""


def profile_steps(loop: Any, packed: Packed, x: Float, v: Float, stages: Float, extra: Extra) -> Mapping[str, float]:
    """Seconds per step by part: the names of its terms, and "python" where a force is written in Python. What is left
    of a step is attachments, gravity, the update.

    Steps of hardly any duration leave x and v (3, n) where they are, and the loop is the one that the run
    compiled, over tuples of the same types, so nothing is compiled for it. A part's cost is what a
    step saves without it. Anchors are those of a copy. Terms that make lists do so as far as vertices move: such steps
    say nothing of those, which are left out.
    """
    lists = making_lists(packed)
    own = silence(own_terms(packed), *lists)
    place, speed = x.copy(), v.copy()

    def run(variant: Packed, force: Extra, steps: int) -> float:
        call_each(variant, "begin", place, steps * BRIEF, variant.threads)
        began = time.perf_counter()
        loop(place, speed, stages, steps, BRIEF, variant, force)
        return (time.perf_counter() - began) / steps

    steps = max(1, min(MOST, int(LONG / max(run(own, extra, 1), 1e-9))))
    variants: dict[str, tuple[Packed, Callable[..., None] | None]] = {"": (own, extra)}
    for part in parts(packed):
        if part not in lists:
            variants[part] = (silence(own, part), extra)
    if extra is not None:
        variants["python"] = (own, lambda x, v, s, a: None)
    # Round after round, so that a disturbance falls on all variants alike.
    rounds = [[run(variant, force, steps) for variant, force in variants.values()] for _ in range(REPEATS)]
    whole, *without = np.min(rounds, axis=0).tolist()
    return {part: max(0.0, whole - rest) for part, rest in zip(list(variants)[1:], without, strict=True)}
