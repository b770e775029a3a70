"""Two recordings on one clock in the studio: how far they are apart is what numpy says."""

from __future__ import annotations

import numpy as np
import pytest
from recorded_sheet import Sheet
from replays import FOLDER, both, frames, waving
from studio_desk import ask

from nuno.recording.reader import open_recording
from nuno.studio.desk import Desk
from nuno_schemas.errors import BadInput


@pytest.fixture(autouse=True)
def folder(desk: Desk) -> None:
    """In the desk's."""
    FOLDER.mkdir()


def test_two_runs_at_the_same_times_are_as_far_apart_as_numpy_says(desk: Desk) -> None:
    waving(FOLDER / "a.mcap")
    waving(FOLDER / "b.mcap", size=1.5, frames=26)
    films, found = both(desk, "a.mcap", "b.mcap")
    with open_recording(FOLDER / "a.mcap") as one, open_recording(FOLDER / "b.mcap") as two:
        apart = [np.linalg.norm(a.x - b.x, axis=1) for a, b in zip(one.frames(), two.frames(), strict=False)]
    assert all(found["exact"]) and len(found["times"]) == 20
    assert found["largest"] == [float(d.max()) for d in apart]
    assert found["rms"] == [float(np.sqrt((d**2).mean())) for d in apart]
    assert max(found["largest"]) == pytest.approx(0.05, abs=1e-4)  # half of the wave's height
    for film, other in (films, films[::-1]):
        _, arrays = frames(desk, film, 4, 3, other)
        assert all(np.array_equal(arrays[f"far{i}"], apart[4 + i].astype(np.float32)) for i in range(3))


def test_the_clock_is_the_slower_rates_and_only_what_has_no_frame_then_is_interpolated(desk: Desk) -> None:
    waving(FOLDER / "50.mcap", 50.0, frames=21)
    waving(FOLDER / "25.mcap", 25.0, frames=11)
    waving(FOLDER / "40.mcap", 40.0, frames=17)
    for order in (("50.mcap", "25.mcap"), ("25.mcap", "50.mcap")):
        _, found = both(desk, *order)
        assert len(found["times"]) == 11 and all(found["exact"]) and max(found["largest"]) == 0.0
    films, found = both(desk, "50.mcap", "40.mcap")
    assert len(found["times"]) == 17
    equal = [i for i, t in enumerate(found["times"]) if abs(t * 50.0 - round(t * 50.0)) < 1e-9]
    assert equal == [0, 4, 8, 12, 16] and [i for i in range(17) if found["exact"][i]] == equal
    assert all((found["largest"][i] == 0.0) == (i in equal) for i in range(17))
    head, arrays = frames(desk, films[0], 1, 1, films[1])
    with open_recording(FOLDER / "50.mcap") as recording:
        x = [frame.x for frame in recording.frames()]
    assert head["frames"][0]["between"]  # 25 ms lie a quarter of the way from 20 to 40 ms
    assert np.allclose(arrays["x0"].reshape(-1, 3) + head["origin"], 0.75 * x[1] + 0.25 * x[2], atol=1e-7)


def test_what_cannot_be_compared_is_refused_or_left_out(desk: Desk) -> None:
    waving(FOLDER / "a.mcap")
    waving(FOLDER / "fine.mcap", sheet=Sheet(12, 10))
    films, found = both(desk, "a.mcap", "fine.mcap")
    assert set(found["largest"]) == {None} and len(found["largest"]) == 20
    _, arrays = frames(desk, films[0], 0, 2, films[1])
    assert "far0" not in arrays and arrays["x0"].size == 3 * Sheet().number
    with pytest.raises(BadInput, match="not compared with itself"):
        ask(desk, "compare", first=films[0], second=films[0])
    with pytest.raises(BadInput, match="no such recording"):
        ask(desk, "replay", recording="../a.mcap")
    (FOLDER / "a.mcap").write_bytes((FOLDER / "fine.mcap").read_bytes())
    ask(desk, "delete", recording="fine.mcap")
    with pytest.raises(BadInput, match="no such recording"):
        ask(desk, "plots", film=films[1])
    desk.screen.forget("a.mcap")
    with pytest.raises(BadInput, match="has changed since"):
        ask(desk, "plots", film=films[0])


def test_two_runs_are_shown_about_one_place(desk: Desk) -> None:
    """Positions are float32 about a whole metre near each film's own first vertex, but one camera sees both."""
    waving(FOLDER / "a.mcap", at=0.499)
    waving(FOLDER / "b.mcap", at=0.501)
    films, _ = both(desk, "a.mcap", "b.mcap")
    alone = [frames(desk, film, 0, 1)[0]["origin"] for film in films]
    assert alone[0] != alone[1]
    (one, a), (two, b) = (frames(desk, film, 0, 1, other) for film, other in (films, films[::-1]))
    assert one["origin"] == two["origin"]
    assert (b["x0"] - a["x0"]).reshape(-1, 3) == pytest.approx(
        np.tile([0.002, 0.0, 0.0], (len(a["x0"]) // 3, 1)), abs=1e-6
    )


def test_runs_without_a_frame_in_common_time_and_cloth_that_is_not_told_are_refused(desk: Desk) -> None:
    waving(FOLDER / "rare.mcap", 1.0, frames=4)
    waving(FOLDER / "short.mcap", begin=0.3)
    _, found = both(desk, "rare.mcap", "short.mcap")
    assert len(found["times"]) == 5 and not any(found["exact"])  # the one that has frames there is the clock
    waving(FOLDER / "untold.mcap", told=False)
    with pytest.raises(BadInput, match="does not describe its cloth"):
        ask(desk, "replay", recording="untold.mcap")
