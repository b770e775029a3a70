"""A raw mass-spring net from a .npz file, which poses an exact problem."""

from __future__ import annotations

from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, Field

from nuno_geometry.mesh_files.npz import NpzFile, Spec, open_npz, require_values
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Fabric, Float, Int, Springs, Yarns
from nuno_schemas.plugin import Config, Files

# A net's yarns are runs of springs, each sharing a vertex with the next, none used twice.


def check_yarns(path: Path, springs: Int, links: Int, ptr: Int, mu: Float) -> None:
    """Raise BadInput, with key and index, for links (l,), ptr (y + 1,), mu (y,) that are not yarns of springs (s, 2) as
    nuno_schemas.fabric.Yarns defines them.
    """
    _check_bounds(path, links, ptr, mu)
    require_values(
        path, "yarn_links", links, links < springs.shape[0], "no such spring", f"0 to {springs.shape[0] - 1}"
    )
    sharing = np.isfinite(mu) & (mu >= 0.0) & (mu < 0.5)
    remedy = "from 1/2 on a long yarn's energy, sum of k e_n^2 / 2 + mu k e_n e_(n+1), has no minimum"
    require_values(path, "mu", mu, sharing, "tension cannot be passed on so", "0 <= mu < 1/2", remedy)
    _check_chains(path, springs, links, ptr)
    _check_once(path, links, ptr)


def _check_bounds(path: Path, links: Int, ptr: Int, mu: Float) -> None:
    if ptr.shape[0] != mu.shape[0] + 1:
        raise BadInput("wrong shape", file=str(path), field="yarn_ptr", value=ptr.shape, limit=f"({mu.shape[0] + 1},)")
    for at, expected in ((0, 0), (-1, links.shape[0])):
        if ptr[at] != expected:
            place = at % ptr.shape[0]
            problem = "yarns begin with the first link and end with the last"
            raise BadInput(problem, file=str(path), field=f"yarn_ptr[{place}]", value=int(ptr[at]), limit=f"{expected}")
    rising = np.concatenate([[True], np.diff(ptr) > 0])
    require_values(path, "yarn_ptr", ptr, rising, "a yarn has no link", "more than the one before")


def _check_chains(path: Path, springs: Int, links: Int, ptr: Int) -> None:
    """Check that each link shares one vertex with the link before it and the other with the link after it."""
    ends = springs[links]
    following = np.ones(links.shape[0], bool)
    following[ptr[:-1]] = False
    same = (ends[1:, :, None] == ends[:-1, None, :]) & following[1:, None, None]
    joined = np.concatenate([[True], same.any(axis=(1, 2)) | ~following[1:]])
    require_values(
        path, "yarn_links", links, joined, "the link shares no vertex with the one before", "a vertex in common"
    )
    entry = np.where(same[:, 0, :].any(axis=1), 0, 1)
    leave = np.where(same[:, :, 0].any(axis=1), 0, 1)
    back = following[1:-1] & following[2:] & (entry[:-1] == leave[1:])
    onward = np.concatenate([[True, True][: links.shape[0]], ~back])
    problem = "the yarn turns back: three links meet in one vertex"
    require_values(path, "yarn_links", links, onward, problem, "leave a link by its other end")


def _check_once(path: Path, links: Int, ptr: Int) -> None:
    """Check that each spring belongs to one yarn, once; a ring names its first link again at its end."""
    first, last = ptr[:-1], ptr[1:] - 1
    counted = np.ones(links.shape[0], bool)
    counted[last[(links[first] == links[last]) & (last >= first + 3)]] = False
    places = np.flatnonzero(counted)
    order = places[np.argsort(links[places], kind="stable")]
    once = np.ones(links.shape[0], bool)
    once[order[1:][links[order[1:]] == links[order[:-1]]]] = False
    problem, remedy = "the spring is a link already", "a ring of three links or more ends with its first link"
    require_values(path, "yarn_links", links, once, problem, "each spring once", remedy)


REAL, INDEX = "fiu", "iu"
KEYS: dict[str, Spec] = {
    "x": (("n", 3), REAL), "v": (("n", 3), REAL), "m": (("n",), REAL), "pinned": (("n",), "b"),
    "springs": (("s", 2), INDEX), "k": (("s",), REAL), "rest": (("s",), REAL), "c": (("s",), REAL),
}  # fmt: skip
"""Shapes by the numbers of vertices n, springs s, links of yarns l, yarns y and y + 1, and kinds of dtype."""
YARN_KEYS: dict[str, Spec] = {"yarn_links": (("l",), INDEX), "yarn_ptr": (("y + 1",), INDEX), "mu": (("y",), REAL)}
LOCK_KEYS: dict[str, Spec] = {"lock": (("s",), REAL), "k_lock": (("s",), REAL)}
"""A file has all keys of a group or none."""
ALL_KEYS = KEYS | YARN_KEYS | LOCK_KEYS
BYTES_PER_VERTEX, BYTES_PER_SPRING = 300, 80
"""The most memory that a run takes, from peaks of recorded runs of 262,144 and 786,432 vertices in a row, springs in
random order: 265 bytes a vertex without springs, 653 with 6 springs for each, 1,193 with 12."""


class NetConfig(Config):
    """The arrays of a file, unchanged."""

    file: str = Field(
        description="a .npz beside the scene with x (n, 3) [m], v (n, 3) [m/s], m (n,) [kg], pinned (n,) bool, "
        "springs (s, 2), k (s,) [N/m], rest (s,) [m], c (s,) [N*s/m], and, if springs are links of yarns, "
        "yarn_links (l,), yarn_ptr (y + 1,), mu (y,) < 1/2, and, if springs lock, lock (s,) strain and "
        "k_lock (s,) >= k [N/m] from there on; no other key"
    )


class Net:
    """A net with exactly the points and springs of its file: no faces, no hinges."""

    name: ClassVar[str] = "net"
    Config: ClassVar[type[BaseModel]] = NetConfig

    def count(self, config: NetConfig, files: Files) -> int:
        with open_npz(files.resolve(config.file)) as file:
            return read_sizes(file)["n"]

    def memory(self, config: NetConfig, files: Files, vertices: int) -> int:
        """Return the most memory that a run takes [bytes], from the file's headers alone, like `count`."""
        with open_npz(files.resolve(config.file)) as file:
            return vertices * BYTES_PER_VERTEX + read_sizes(file)["s"] * BYTES_PER_SPRING

    def build(self, config: NetConfig, files: Files, seed: int) -> Fabric:
        """Build the net. Raises BadInput that names the key, the index and the value."""
        path = files.resolve(config.file)
        with open_npz(path) as file:
            number = read_sizes(file)["n"]
            data = file.arrays(ALL_KEYS, {"springs": (number, "no such vertex")})
        check_values(path, data)
        lock, k_lock = data.get("lock"), data.get("k_lock")
        springs = Springs.from_pairs(data["springs"], data["k"], data["rest"], data["c"], lock=lock, k_lock=k_lock)
        return Fabric(
            name=self.name,
            position=data["x"],
            velocity=data["v"],
            mass=data["m"],
            pinned=data["pinned"],
            faces=np.zeros((0, 3), np.int32),
            springs=springs if springs.number else None,
            yarns=Yarns(data["yarn_links"], data["yarn_ptr"], data["mu"], np.zeros_like(data["mu"], np.int8))
            if "mu" in data
            else None,
        )


def read_sizes(file: NpzFile) -> dict[str, int]:
    """Return the numbers of vertices "n" and springs "s", and of yarns if there are any, from the headers alone.

    Raises BadInput for a missing or unknown key, a wrong dtype or shape, and a header that announces more than the file
    holds, before anything is allocated.
    """
    file.require(KEYS, ALL_KEYS)
    for what, keys in (("yarns", YARN_KEYS), ("springs that lock", LOCK_KEYS)):
        for name in keys if any(name in file.names for name in keys) else ():
            if name not in file.names:
                remedy = f"{what} need {', '.join(keys)}; leave all out for plain springs"
                raise BadInput("an array is missing", file=str(file.path), field=name, remedy=remedy)
    return file.sizes(ALL_KEYS)


def check_values(path: Path, data: dict[str, NDArray[Any]]) -> None:
    """Raise BadInput for the first value out of range, with its key and index."""

    def require(name: str, good: NDArray[np.bool_], problem: str, limit: str) -> None:
        require_values(path, name, data[name], good, problem, limit)

    for name in ("x", "v", "m", "k", "rest", "c", *(name for name in LOCK_KEYS if name in data)):
        require(name, np.isfinite(data[name]), "not a finite number", "finite")
    require("m", data["m"] > 0, "a mass must be positive, of pinned vertices too", "> 0")
    for name in ("k", "rest", "c"):
        require(name, data[name] >= 0, "must not be negative", ">= 0")
    if "lock" in data:
        require("lock", data["lock"] >= 0, "a spring locks at a strain that is none", ">= 0")
        require("k_lock", data["k_lock"] >= data["k"], "what locks grows stiffer", ">= k")
    _require_distinct(path, data["springs"])
    if "mu" in data:
        check_yarns(path, data["springs"], data["yarn_links"], data["yarn_ptr"], data["mu"])


def _require_distinct(path: Path, springs: Int) -> None:
    loops = np.flatnonzero(springs[:, 0] == springs[:, 1])
    if loops.size:
        row = int(loops[0])
        raise BadInput(
            "a spring from a vertex to itself", file=str(path), field=f"springs[{row}]", value=springs[row].tolist()
        )
    # One number per pair: a net's springs are most of its memory, and sorting pairs copies them.
    key = springs.min(axis=1).astype(np.int64) << 32 | springs.max(axis=1)
    ordered = np.sort(key)
    same = ordered[1:][ordered[1:] == ordered[:-1]]
    if same.size:
        first, second = (int(row) for row in np.flatnonzero(key == same[0])[:2])
        raise BadInput(
            f"the same two vertices as springs[{first}]",
            file=str(path),
            field=f"springs[{second}]",
            value=springs[second].tolist(),
            remedy="join them: add their k and c",
        )
