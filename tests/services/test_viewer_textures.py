"""Textures in the viewer are those of the run, wherever it is watched."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from scenes import write_scene
from viewer_run import fabric, sheet

import nuno
from nuno.bus.encodings import decode_arrays
from nuno.cli import main
from nuno.viewer.cloth import read_image
from nuno.viewer.service import with_own_textures
from nuno_schemas.messages import FABRIC

PIXELS = np.arange(48, dtype=np.uint8).reshape(4, 4, 3)


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    """A recording of a sheet with an image, which is gone from the disk since."""
    folder = tmp_path / "scene"
    folder.mkdir()
    Image.fromarray(PIXELS).save(folder / "image.png")
    model = {"plugin": "sheet", "resolution": [4, 4], "texture": "image.png"}
    scene = write_scene(folder, objects=[{"name": "cloth", "model": model}], duration=0.1)
    nuno.run(scene, record=tmp_path / "run.mcap")
    (folder / "image.png").unlink()
    return tmp_path / "run.mcap"


def test_a_replay_is_saved_with_the_recordings_own_image(recording: Path, tmp_path: Path) -> None:
    import rerun.chunk

    saved = tmp_path / "again.rrd"
    assert main(["replay", str(recording), "--fast", "--save", str(saved)]) == 0
    column = "Mesh3D:albedo_texture_buffer"
    batches = (chunk.to_record_batch() for chunk in rerun.chunk.RrdReader(saved).stream().to_chunks())
    found = [batch[column].to_pylist() for batch in batches if column in batch.schema.names]
    assert np.ravel(found).tolist() == PIXELS.ravel().tolist()


def test_a_live_view_of_a_replay_is_given_an_image_that_is_there(
    recording: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen: list[Any] = []

    class Watched:
        """Reads the image as soon as a view hears of it."""

        pid, page, error, shown, skipped = None, "", "", 0, 0

        def __init__(self, *_: object) -> None:
            pass

        def feed(self, topic: str, frame: int, t: float, payload: bytes) -> None:
            if topic == FABRIC.name:
                seen.append(read_image(decode_arrays(payload)[1]["objects"][0]["texture"]))

        def finish(self, stays: bool = True) -> None:
            pass

    monkeypatch.setattr("nuno.viewer.service.LiveView", Watched)
    assert main(["replay", str(recording), "--fast", "--view", "web"]) == 0
    assert len(seen) == 1
    assert np.array_equal(seen[0], PIXELS)


@pytest.mark.parametrize(
    ("texture", "own"),
    [
        ("/elsewhere/scene/image.png", "/here/image.png"),
        ("/elsewhere/scene/prints/leaf.png", "/here/prints/leaf.png"),
        ("/elsewhere/scene/leaf.png", "leaf.png (not among the scene's files)"),
        ("/etc/secret.png", "secret.png (not among the scene's files)"),
        (None, None),
    ],
)
def test_a_message_picks_no_file_but_the_scenes_own(texture: str | None, own: str | None) -> None:
    files = {name: Path("/here") / name for name in ("image.png", "prints/leaf.png")}
    payload = fabric(*sheet(3, 3), texture=texture)
    arrays, text = decode_arrays(with_own_textures(payload, files))
    before, _ = decode_arrays(payload)
    assert text["objects"][0]["texture"] == own
    assert {name: values.tobytes() for name, values in arrays.items()} == {
        name: values.tobytes() for name, values in before.items()
    }


def test_what_is_no_fabric_message_is_left_for_the_views_to_refuse() -> None:
    assert with_own_textures(b"noise", {}) == b"noise"
