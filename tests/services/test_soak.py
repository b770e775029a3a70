"""Parts of make soak on a small scale, and that they would notice what they are there to notice."""

from __future__ import annotations

import shutil
from collections import namedtuple
from pathlib import Path

import pytest
from recorded_sheet import metadata

from nuno.recording.writer import RecordingWriter
from nuno_schemas.errors import BadInput
from nuno_schemas.messages import STATE, Header
from soak import same_bits
from soak.lost import KB, MB, Memory, Stream, count_lost, growth, measure, need_room
from soak.same_bits import Seen
from soak.traffic import payload_of, template


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


@pytest.mark.full
def test_nothing_is_lost_between_processes_beside_a_hung_subscriber_on_a_slow_disk(tmp_path: Path) -> None:
    results = measure(tmp_path, Stream("100 KB", 120, 100 * KB, disk=20 * MB, seconds=(1e6,)), judge_memory=False)
    found = {result.what: result.median for result in results}
    assert (found["messages lost"], found["messages changed"], found["recording complete"]) == (0, 0, 1)
    # 12 MB in chunks of 4 MB, of which the last need not be written before its messages are acknowledged.
    assert found["rate"] < 1.6 * 20
    assert list(tmp_path.iterdir()) == []


def test_what_is_lost_or_changed_is_counted(tmp_path: Path) -> None:
    stream = Stream("1 KB", 50, KB)
    head, tail = template(stream.size)
    writer = RecordingWriter(tmp_path / "a.mcap", metadata(), {})
    for number in range(stream.count - 2):
        if number not in (3, 20, 21):
            header = Header(run="r", service="simulation", seq=number, frame=number, t=number / 50)
            writer.write(STATE.name, header, payload_of(number + (number == 30), head, tail))
    writer.finish({})
    assert count_lost(tmp_path / "a.mcap", stream) == (5, 1)


def test_memory_that_grows_is_not_flat() -> None:
    for samples, verdict in (([100, 110, 105, 109] * 5, "bar met"), (list(range(100, 200)), "missed")):
        memory = Memory(0, [10 * MB * sample for sample in samples])
        (result,) = growth("case", {"recorder": memory})
        assert result.verdict == verdict


def test_a_disk_that_is_too_small_is_refused_before_anything_starts(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    usage = namedtuple("usage", "total used free")
    monkeypatch.setattr(shutil, "disk_usage", lambda folder: usage(0, 0, 5 * 10**9))
    need_room(tmp_path, 3 * 10**9)
    with pytest.raises(BadInput, match="not enough room for the recording") as caught:
        need_room(tmp_path, 9 * 10**9)
    assert (caught.value.value, caught.value.limit) == ("5.0 GB free", "10.1 GB")
