"""What a scene will take is known before anything is allocated, springs of their own counted."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import psutil
import pytest
import yaml
from model_files import Folder, files, net_arrays

from nuno.scene import scene_file
from nuno.scene.scene_file import Loaded
from nuno.simulation import cloth
from nuno_cloth.models.membrane import BYTES_PER_VERTEX as MESH
from nuno_cloth.models.net import BYTES_PER_SPRING as SPRING
from nuno_cloth.models.net import BYTES_PER_VERTEX as POINT
from nuno_schemas.errors import BadInput

__all__ = ["files"]


def scene(folder: Path, *models: dict[str, object]) -> Loaded:
    objects = [{"name": f"cloth{i}", "model": model} for i, model in enumerate(models)]
    data = {"nuno": 1, "name": "memory", "duration": 1, "solver": {"plugin": "rk4"}, "objects": objects}
    path = folder / "scene.yaml"
    path.write_text(yaml.safe_dump(data))
    return scene_file.read(path)


def test_objects_add_up_by_their_own_figures(files: Folder) -> None:
    sheet, net, mesh = {"plugin": "sheet", "resolution": [30, 20]}, {"plugin": "net"}, {"plugin": "mesh"}
    loaded = scene(files.root, sheet, net | {"file": "net.npz"}, mesh | {"file": "sheet.obj"})
    expected = 600 * cloth.BYTES_PER_VERTEX + 3 * POINT + 2 * SPRING + 30 * MESH
    assert cloth.estimate_memory(loaded) == (600 + 3 + 30, expected)


def test_a_net_of_many_springs_is_refused_where_its_vertices_alone_would_fit(
    files: Folder, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Every point joined to every other: 40 points, 780 springs."""
    n = 40
    first, second = np.triu_indices(n, 1)
    s = len(first)
    arrays = net_arrays() | {
        "x": np.random.default_rng(1).normal(size=(n, 3)), "v": np.zeros((n, 3)), "m": np.ones(n),
        "pinned": np.arange(n) == 0, "springs": np.stack([first, second], 1),
        "k": np.ones(s), "rest": np.ones(s), "c": np.zeros(s),
    }  # fmt: skip
    np.savez(files.root / "net.npz", **arrays)  # type: ignore[arg-type]
    loaded = scene(files.root, {"plugin": "net", "file": "net.npz"})
    needed = n * POINT + s * SPRING

    def free(size: int) -> None:
        monkeypatch.setattr(psutil, "virtual_memory", lambda: SimpleNamespace(available=size))

    free(needed)
    cloth.check_memory(loaded)
    free(needed - 1)
    with pytest.raises(BadInput, match="does not fit in memory") as caught:
        cloth.build_fabric(loaded)
    assert str(caught.value.value).startswith("40 vertices")
    assert caught.value.field == "objects"
