"""The matrix of same bits holds for a small scene, and would show where it did not."""

from __future__ import annotations

from soak import same_bits
from soak.same_bits import Seen


def test_a_changed_run_has_one_digest_in_every_way() -> None:
    """Threads, no recording, pauses, resumed before or after a change, and simulated again."""
    ways, digests = same_bits.run(quick=True, seed=1)
    assert ways.samples[0] >= 8 and digests.samples == (1,) and digests.verdict == "bar met", digests.note


def test_another_digest_is_a_miss_and_is_named() -> None:
    first, other = Seen(("a",), ((0, "x"), (1, "y"))), Seen(("a",), ((0, "x"), (1, "z")))
    assert same_bits.judge("case", {"one": first, "two": Seen(("a",)), "three": first})[1].verdict == "bar met"
    missed = same_bits.judge("case", {"one": first, "two": Seen(("a",)), "three": other})[1]
    assert missed.verdict == "missed" and missed.samples == (2,) and missed.note == "others than one: three"
    assert same_bits.judge("case", {"one": first, "two": Seen(("b",))})[1].verdict == "missed"
