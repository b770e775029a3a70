"""Where cloth passes through cloth, in the viewer."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from rrd import read, write
from viewer_run import RATE, messages

from nuno_schemas.messages import PENETRATION, Penetration


def test_cloth_that_passes_through_cloth_is_marked_in_those_frames_alone(tmp_path: Path) -> None:
    """With whose cloth it is; and the least distance is a curve in millimetres, with a gap where none was found."""
    places, found = [(0.1, 0.2, 0.3), (0.4, 0.5, 0.6), (0.7, 0.8, 0.9)], dict[int, Penetration]()
    objects = [("sheet", "scarf"), ("sheet", "sheet"), ("scarf", "sheet")]
    for frame, number in enumerate((0, 3, 1, 0, 0)):
        distance = 0.0 if number else 5e-4 if frame == 0 else None
        found[frame] = Penetration(
            frame=frame, t=frame / RATE, depth=0.0, vertex=-1, inside=0, mean=0.0, seconds=0.0, crossings=number,
            places=places[:number], objects=objects[:number], distance=distance,
        )  # fmt: skip
    fed = [
        (topic, frame, t, found[frame].model_dump_json().encode() if topic == PENETRATION.name else payload)
        for topic, frame, t, payload in messages(5)
    ]
    path = write(tmp_path / "run.rrd", fed)
    between, itself = "/world/crossings/scarf/sheet", "/world/crossings/sheet/sheet"
    assert read(path, between, "Points3D:positions") == {
        1: [pytest.approx(places[0]), pytest.approx(places[2])], 2: [pytest.approx(places[0])],
    }  # fmt: skip
    assert read(path, itself, "Points3D:positions") == {1: [pytest.approx(places[1])]}
    labels = [read(path, entity, "Points3D:labels")[1] for entity in (between, itself)]
    assert labels == [["scarf passes through sheet"], ["sheet passes through itself"]]
    assert {e: list(read(path, e, "Clear:is_recursive")) for e in (between, itself)} == {between: [3], itself: [2]}
    curve = read(path, "/plots/distance", "Scalars:scalars")
    assert [curve[frame][0] for frame in range(5)] == pytest.approx([0.5, 0.0, 0.0, np.nan, np.nan], nan_ok=True)
