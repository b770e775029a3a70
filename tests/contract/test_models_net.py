"""A net holds the file's numbers, and refuses bad ones by name."""

from __future__ import annotations

import zipfile
from typing import Any

import numpy as np
import pytest
from model_files import Folder, build, files, net_arrays

from nuno_cloth.models.net import Net, NetConfig
from nuno_schemas.errors import BadInput

__all__ = ["files"]

NET_FAULTS: dict[str, tuple[dict[str, Any], str, object]] = {
    "missing key": ({"k": None}, "k", None),
    "unknown key": ({"stiffness": np.zeros(2)}, "stiffness", None),
    "shape of x": ({"x": np.zeros((3, 2))}, "x", (3, 2)),
    "lengths differ": ({"m": np.ones(2)}, "m", (2,)),
    "spring lengths differ": ({"rest": np.ones(3)}, "rest", (3,)),
    "dtype of springs": ({"springs": np.array([[0.0, 1], [1, 2]])}, "springs", "float64"),
    "dtype of pinned": ({"pinned": np.array([0.0, 1, 0])}, "pinned", "float64"),
    "text": ({"m": np.array(["a", "b", "c"])}, "m", "<U1"),
    "infinite position": ({"x": np.array([[0.0, 0, 0], [1, np.inf, 0], [0, 1, 0]])}, "x[1, 1]", np.inf),
    "zero mass": ({"m": np.array([1.0, 0, 1])}, "m[1]", 0.0),
    "negative mass where pinned": ({"m": np.array([-1.0, 1, 1])}, "m[0]", -1.0),
    "spring to itself": ({"springs": np.array([[0, 1], [2, 2]])}, "springs[1]", [2, 2]),
    "negative index": ({"springs": np.array([[0, 1], [-1, 2]])}, "springs[1, 0]", -1),
    "index too large": ({"springs": np.array([[0, 3], [1, 2]])}, "springs[0, 1]", 3),
    "index that wraps": ({"springs": np.array([[0, 1], [1, 2**32]])}, "springs[1, 1]", 2**32),
    "duplicate, other order": ({"springs": np.array([[0, 1], [1, 0]])}, "springs[1]", [1, 0]),
    "negative k": ({"k": np.array([1.0, -2])}, "k[1]", -2.0),
    "negative rest": ({"rest": np.array([-1.0, 2])}, "rest[0]", -1.0),
    "negative c": ({"c": np.array([0.0, -2])}, "c[1]", -2.0),
}


@pytest.mark.parametrize("fault", NET_FAULTS)
def test_bad_nets_are_refused_by_name(fault: str, files: Folder) -> None:
    change, field, value = NET_FAULTS[fault]
    arrays = {name: array for name, array in (net_arrays() | change).items() if array is not None}
    np.savez(files.root / "bad.npz", **arrays)
    with pytest.raises(BadInput) as caught:
        build(Net(), {"file": "bad.npz"}, files)
    assert caught.value.field == field
    assert caught.value.value == value
    assert str(files.root / "bad.npz") in str(caught.value)


@pytest.mark.parametrize("key", ["x", "v", "m", "k", "rest", "c"])
def test_nan_in_a_net_is_refused(key: str, files: Folder) -> None:
    arrays = net_arrays()
    arrays[key].flat[1] = np.nan
    np.savez(files.root / "bad.npz", **arrays)  # type: ignore[arg-type]
    with pytest.raises(BadInput) as caught:
        build(Net(), {"file": "bad.npz"}, files)
    assert caught.value.field is not None and caught.value.field.startswith(f"{key}[")


def test_files_that_are_no_nets(files: Folder) -> None:
    (files.root / "text.npz").write_text("not a zip")
    np.savez(files.root / "pickle.npz", **(net_arrays() | {"m": np.array([1, "x", None], object)}))
    for name in ("text.npz", "pickle.npz"):
        with pytest.raises(BadInput, match=r"read|dtype"):
            build(Net(), {"file": name}, files)
    with pytest.raises(BadInput):
        Net().count(NetConfig(file="text.npz"), files)


def test_a_header_that_lies_is_refused_before_anything_is_allocated(files: Folder) -> None:
    with zipfile.ZipFile(files.root / "net.npz") as good, zipfile.ZipFile(files.root / "lie.npz", "w") as bad:
        for name in good.namelist():
            data = good.read(name)
            bad.writestr(name, data.replace(b"(3, 3)", b"(9" + b"0" * 12 + b", 3)") if name == "x.npy" else data)
    for work in (Net().count, lambda config, files: Net().build(config, files, 0)):
        with pytest.raises(BadInput) as caught:
            work(NetConfig(file="lie.npz"), files)
        assert caught.value.field == "x"


@pytest.mark.parametrize("points", [0, 2])
def test_nets_without_springs_or_points_are_legal(points: int, files: Folder) -> None:
    kept = {"x": points, "v": points, "m": points, "pinned": points}
    arrays = {name: array[: kept.get(name, 0)] for name, array in net_arrays().items()}
    np.savez(files.root / "bare.npz", **arrays)  # type: ignore[arg-type]
    fabric = build(Net(), {"file": "bare.npz"}, files)
    assert fabric.number == points == Net().count(NetConfig(file="bare.npz"), files)
    assert fabric.springs is None and fabric.hinges is None


def test_a_net_holds_the_files_numbers(files: Folder) -> None:
    fabric, arrays = build(Net(), {"file": "net.npz"}, files), net_arrays()
    assert fabric.springs is not None
    assert np.array_equal(fabric.position, arrays["x"]) and np.array_equal(fabric.pinned, arrays["pinned"])
    assert np.array_equal(fabric.springs.pairs(), arrays["springs"])
    for name in ("k", "rest", "c"):
        assert np.array_equal(getattr(fabric.springs, name), arrays[name])
