"""A net's yarns: the file's numbers, and what is no yarn refused by key and index."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from model_files import Folder, build, files, net_arrays

from nuno_cloth.models.net import Net
from nuno_schemas.errors import BadInput

__all__ = ["files"]


def arrays() -> dict[str, np.ndarray[Any, Any]]:
    """A square of four springs and its diagonal: a ring around it, and the diagonal by itself."""
    return {
        "x": np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]),
        "v": np.zeros((4, 3)),
        "m": np.ones(4),
        "pinned": np.zeros(4, bool),
        "springs": np.array([[0, 1], [2, 1], [2, 3], [3, 0], [0, 2]]),
        "k": np.ones(5),
        "rest": np.ones(5),
        "c": np.zeros(5),
        "yarn_links": np.array([0, 1, 2, 3, 0, 4]),
        "yarn_ptr": np.array([0, 5, 6]),
        "mu": np.array([0.2, 0.0]),
    }


FAULTS: dict[str, tuple[dict[str, Any], str, object]] = {
    "missing key": ({"yarn_ptr": None}, "yarn_ptr", None),
    "unknown key": ({"yarn_kind": np.zeros(2)}, "yarn_kind", None),
    "dtype": ({"yarn_links": np.zeros(6)}, "yarn_links", "float64"),
    "shape": ({"mu": np.zeros((2, 1))}, "mu", (2, 1)),
    "one mu too few": ({"mu": np.array([0.2])}, "yarn_ptr", (3,)),
    "no such spring": ({"yarn_links": np.array([0, 1, 2, 3, 0, 5])}, "yarn_links[5]", 5),
    "negative link": ({"yarn_links": np.array([0, 1, 2, -3, 0, 4])}, "yarn_links[3]", -3),
    "link that wraps": ({"yarn_links": np.array([0, 1, 2, 2**32 + 3, 0, 4])}, "yarn_links[3]", 2**32 + 3),
    "first not 0": ({"yarn_ptr": np.array([1, 5, 6])}, "yarn_ptr[0]", 1),
    "last not all": ({"yarn_ptr": np.array([0, 4, 5])}, "yarn_ptr[2]", 5),
    "falling": ({"yarn_ptr": np.array([0, 5, 3, 6]), "mu": np.zeros(3)}, "yarn_ptr[2]", 3),
    "empty yarn": ({"yarn_ptr": np.array([0, 5, 5, 6]), "mu": np.zeros(3)}, "yarn_ptr[2]", 5),
    "links apart": ({"yarn_links": np.array([0, 2]), "yarn_ptr": np.array([0, 2]), "mu": np.ones(1) / 4},
                    "yarn_links[1]", 2),
    "turns back": ({"yarn_links": np.array([0, 3, 4]), "yarn_ptr": np.array([0, 3]), "mu": np.ones(1) / 4},
                   "yarn_links[2]", 4),
    "used twice": ({"yarn_links": np.array([0, 1, 2, 3, 0, 3])}, "yarn_links[5]", 3),
    "ring of two": ({"yarn_links": np.array([0, 1, 0]), "yarn_ptr": np.array([0, 3]), "mu": np.ones(1) / 4},
                    "yarn_links[2]", 0),
    "one half": ({"mu": np.array([0.2, 0.5])}, "mu[1]", 0.5),
    "locks without stiffness": ({"lock": np.ones(5)}, "k_lock", None),
    "locks below rest": ({"lock": np.array([1, 1, -0.1, 1, 1]), "k_lock": np.ones(5)}, "lock[2]", -0.1),
    "locks and softens": ({"lock": np.ones(5), "k_lock": np.array([1, 1, 1, 0.5, 1])}, "k_lock[3]", 0.5),
    "negative": ({"mu": np.array([-0.1, 0.2])}, "mu[0]", -0.1),
}  # fmt: skip


@pytest.mark.parametrize("fault", FAULTS)
def test_what_is_no_yarn_is_refused_by_name(fault: str, files: Folder) -> None:
    change, field, value = FAULTS[fault]
    np.savez(files.root / "bad.npz", **{name: a for name, a in (arrays() | change).items() if a is not None})
    with pytest.raises(BadInput) as caught:
        build(Net(), {"file": "bad.npz"}, files)
    assert caught.value.field == field
    assert caught.value.value == value


def test_not_a_number_is_refused(files: Folder) -> None:
    np.savez(files.root / "bad.npz", **(arrays() | {"mu": np.array([0.2, np.nan])}))  # type: ignore[arg-type]
    with pytest.raises(BadInput) as caught:
        build(Net(), {"file": "bad.npz"}, files)
    assert caught.value.field == "mu[1]"


def test_the_reason_for_one_half_is_given(files: Folder) -> None:
    np.savez(files.root / "bad.npz", **(arrays() | {"mu": np.array([0.7, 0.0])}))  # type: ignore[arg-type]
    with pytest.raises(BadInput) as caught:
        build(Net(), {"file": "bad.npz"}, files)
    assert "energy" in str(caught.value) and "1/2" in str(caught.value)


def test_a_net_holds_the_files_yarns(files: Folder) -> None:
    np.savez(files.root / "yarns.npz", **arrays())  # type: ignore[arg-type]
    fabric = build(Net(), {"file": "yarns.npz"}, files)
    assert fabric.yarns is not None
    for name, key in (("links", "yarn_links"), ("ptr", "yarn_ptr"), ("mu", "mu")):
        assert np.array_equal(getattr(fabric.yarns, name), arrays()[key])
    neighbours, yarn = fabric.yarns.neighbours()
    assert neighbours.tolist() == [[0, 1], [1, 2], [2, 3], [3, 0]]
    assert yarn.tolist() == [0, 0, 0, 0]


def test_a_net_without_the_keys_has_no_yarns(files: Folder) -> None:
    np.savez(files.root / "plain.npz", **net_arrays())  # type: ignore[arg-type]
    assert build(Net(), {"file": "plain.npz"}, files).yarns is None


def test_locks_are_the_files(files: Folder) -> None:
    lock, k_lock = np.linspace(0.0, 1.0, 5), np.linspace(1.0, 3.0, 5)
    np.savez(files.root / "net.npz", **(arrays() | {"lock": lock, "k_lock": k_lock}))  # type: ignore[arg-type]
    springs = build(Net(), {"file": "net.npz"}, files).springs
    assert springs is not None
    assert np.array_equal(springs.lock, lock) and np.array_equal(springs.k_lock, k_lock)  # type: ignore[arg-type]
