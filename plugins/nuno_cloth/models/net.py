"""A raw mass-spring net from a .npz file, so that anybody can pose an exact problem."""

from __future__ import annotations

from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, Field

from nuno_cloth.models.net_yarns import check_yarns
from nuno_kernels.npz_file import NpzFile, open_npz
from nuno_schemas.errors import BadInput, nearest
from nuno_schemas.fabric import Fabric, Int, Springs
from nuno_schemas.plugin import Config, Files
from nuno_schemas.yarns import Yarns

# Name, shape after the leading n (vertices) or s (springs), and kind of dtype allowed.
KEYS: dict[str, tuple[str, tuple[int, ...], str]] = {
    "x": ("n", (3,), "fiu"),
    "v": ("n", (3,), "fiu"),
    "m": ("n", (), "fiu"),
    "pinned": ("n", (), "b"),
    "springs": ("s", (2,), "iu"),
    "k": ("s", (), "fiu"),
    "rest": ("s", (), "fiu"),
    "c": ("s", (), "fiu"),
}
YARN_KEYS: dict[str, tuple[str, tuple[int, ...], str]] = {
    "yarn_links": ("l", (), "iu"),
    "yarn_ptr": ("y + 1", (), "iu"),
    "mu": ("y", (), "fiu"),
}
LOCK_KEYS: dict[str, tuple[str, tuple[int, ...], str]] = {"lock": ("s", (), "fiu"), "k_lock": ("s", (), "fiu")}
"""All or none of each."""
ALL_KEYS = KEYS | YARN_KEYS | LOCK_KEYS
BYTES_PER_VERTEX, BYTES_PER_SPRING = 300, 80
"""What a run takes at most, from peaks of recorded runs of 262,144 and 786,432 vertices in a row,
springs in random order: 265 bytes a vertex without springs, 653 with 6 springs for each, 1,193
with 12."""
DTYPES = {"fiu": "float64", "iu": "int32", "b": "bool"}


class NetConfig(Config):
    """Arrays of a file, as they are."""

    file: str = Field(
        description="a .npz beside the scene with x (n, 3) [m], v (n, 3) [m/s], m (n,) [kg], pinned (n,) bool, "
        "springs (s, 2), k (s,) [N/m], rest (s,) [m], c (s,) [N*s/m], and, if springs are links of yarns, "
        "yarn_links (l,), yarn_ptr (y + 1,), mu (y,) < 1/2, and, if springs lock, lock (s,) strain and "
        "k_lock (s,) >= k [N/m] from there on; no other key"
    )


class Net:
    """Exactly the points and springs of the file: no faces, no hinges."""

    name: ClassVar[str] = "net"
    Config: ClassVar[type[BaseModel]] = NetConfig

    def count(self, config: NetConfig, files: Files) -> int:
        with open_npz(files.resolve(config.file)) as file:
            return read_sizes(file)["n"]

    def memory(self, config: NetConfig, files: Files, vertices: int) -> int:
        """What a run takes at most [bytes]; from the file's headers, like count."""
        with open_npz(files.resolve(config.file)) as file:
            return vertices * BYTES_PER_VERTEX + read_sizes(file)["s"] * BYTES_PER_SPRING

    def build(self, config: NetConfig, files: Files, seed: int) -> Fabric:
        """Raises BadInput that names the key, the index and the value."""
        path = files.resolve(config.file)
        data = load_arrays(path)
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
            yarns=_yarns(data) if "mu" in data else None,
        )


def _yarns(data: dict[str, NDArray[Any]]) -> Yarns:
    kind = np.zeros(data["mu"].shape[0], np.int8)
    return Yarns(data["yarn_links"], data["yarn_ptr"], data["mu"], kind)


def _require_keys(path: Path, names: list[str]) -> None:
    for name in KEYS:
        if name not in names:
            raise BadInput("a key is missing", file=str(path), field=name, remedy=f"the file needs {', '.join(KEYS)}")
    for what, keys in (("yarns", YARN_KEYS), ("springs that lock", LOCK_KEYS)):
        for name in keys if any(name in names for name in keys) else ():
            if name not in names:
                remedy = f"{what} need {', '.join(keys)}; leave all out for plain springs"
                raise BadInput("a key is missing", file=str(path), field=name, remedy=remedy)
    for name in names:
        if name not in ALL_KEYS:
            raise BadInput("unknown key", file=str(path), field=name, remedy=nearest(name, ALL_KEYS))


def read_sizes(file: NpzFile) -> dict[str, int]:
    """Numbers of vertices "n" and springs "s", and of yarns where it has any, from the headers alone.

    Raises BadInput for a missing or unknown key, a wrong dtype or shape, and a header that
    announces more than the file holds: nothing is allocated for a lie.
    """
    path = file.path
    _require_keys(path, file.names)
    sizes: dict[str, int] = {}
    for name, (letter, rest, kinds) in ALL_KEYS.items():
        if name not in file.names:
            continue
        header = file.header(name)
        shape, dtype = header.shape, header.dtype
        if dtype.kind not in kinds and 0 not in shape:
            raise BadInput("wrong dtype", file=str(path), field=name, value=str(dtype), limit=DTYPES[kinds])
        leading = sizes.get(letter)
        if len(shape) != 1 + len(rest) or shape[1:] != rest or leading not in (None, shape[0]):
            wanted = ", ".join([letter if leading is None else str(leading), *map(str, rest)])
            limit = f"({wanted}{',' if not rest else ''})"
            raise BadInput("wrong shape", file=str(path), field=name, value=shape, limit=limit)
        header.check(path, name)
        sizes[letter] = shape[0]
    return sizes


def load_arrays(path: Path) -> dict[str, NDArray[Any]]:
    """The eight arrays, and those of yarns and locks where it has them, C-contiguous, in float64, int32 and bool.

    Pickles are never read.
    """
    arrays: dict[str, NDArray[Any]] = {}
    with open_npz(path) as file:
        sizes = read_sizes(file)
        for name in ALL_KEYS:
            if name not in file.names:
                continue
            array = file.array(name)
            if name == "springs":
                _require_indices(path, array, sizes["n"])
            if name in YARN_KEYS:
                _require_int32(path, name, array)
            arrays[name] = np.ascontiguousarray(array, DTYPES[ALL_KEYS[name][2]])
    return arrays


def _require_indices(path: Path, springs: NDArray[Any], number: int) -> None:
    """Checked before the conversion to int32, which would wrap."""
    bad = np.argwhere((springs < 0) | (springs >= number))
    if bad.size:
        row, col = bad[0]
        limit = f"0 to {number - 1}" if number else "no vertex exists"
        raise BadInput(
            "no such vertex", file=str(path), field=f"springs[{row}, {col}]", value=int(springs[row, col]), limit=limit
        )


def _require_int32(path: Path, name: str, values: NDArray[Any]) -> None:
    """What an index cannot be, whatever it counts, is refused before the conversion would wrap it."""
    most = np.iinfo(np.int32).max
    if values.dtype.kind in "iu":
        _require(path, name, values, (values >= 0) & (values <= most), f"0 to {most}", "not an index")


def check_values(path: Path, data: dict[str, NDArray[Any]]) -> None:
    """Raises BadInput for the first value out of range, with its key and index."""
    for name in ("x", "v", "m", "k", "rest", "c", *(name for name in LOCK_KEYS if name in data)):
        _require(path, name, data[name], np.isfinite(data[name]), "finite", "not a finite number")
    _require(path, "m", data["m"], data["m"] > 0, "> 0", "a mass must be positive, of pinned vertices too")
    for name in ("k", "rest", "c"):
        _require(path, name, data[name], data[name] >= 0, ">= 0", "must not be negative")
    if "lock" in data:
        _require(path, "lock", data["lock"], data["lock"] >= 0, ">= 0", "a spring locks at a strain that is none")
        _require(path, "k_lock", data["k_lock"], data["k_lock"] >= data["k"], ">= k", "what locks grows stiffer")
    _require_distinct(path, data["springs"])
    if "mu" in data:
        check_yarns(path, data["springs"], data["yarn_links"], data["yarn_ptr"], data["mu"])


def _require(path: Path, name: str, values: NDArray[Any], good: NDArray[np.bool_], limit: str, problem: str) -> None:
    bad = np.argwhere(~good)
    if bad.size:
        index = tuple(int(i) for i in bad[0])
        place = ", ".join(map(str, index))
        raise BadInput(problem, file=str(path), field=f"{name}[{place}]", value=values[index].item(), limit=limit)


def _require_distinct(path: Path, springs: Int) -> None:
    loops = np.flatnonzero(springs[:, 0] == springs[:, 1])
    if loops.size:
        row = int(loops[0])
        raise BadInput(
            "a spring from a vertex to itself", file=str(path), field=f"springs[{row}]", value=springs[row].tolist()
        )
    # One number per pair: a net's springs are most of its memory, and sorting pairs copies them.
    key = springs.min(axis=1).astype(np.int64) << 32 | springs.max(axis=1)
    known = np.sort(key)
    same = known[1:][known[1:] == known[:-1]]
    if same.size:
        first, second = (int(row) for row in np.flatnonzero(key == same[0])[:2])
        raise BadInput(
            f"the same two vertices as springs[{first}]",
            file=str(path),
            field=f"springs[{second}]",
            value=springs[second].tolist(),
            remedy="join them: add their k and c",
        )
