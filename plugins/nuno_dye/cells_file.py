"""Arrays of cells from a .npz file: sizes from its headers first, so that nothing is allocated for a lie."""

from __future__ import annotations

import math
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nuno_schemas.errors import BadInput, nearest

NUMBERS, FLAGS = "fiu", "b"
KEYS = {
    "fibre": FLAGS, "up": FLAGS, "porosity": NUMBERS, "tau1": NUMBERS, "resist": NUMBERS, "phi": NUMBERS,
    "fixed": NUMBERS,
}  # fmt: skip
"""Arrays that the file holds, and the kinds of dtype each may have."""
AMOUNTS = ("phi", "fixed")
"""One for each dye, where there are several."""
DTYPES = {NUMBERS: "float64", FLAGS: "bool"}

Shape = tuple[int, ...]


def read_shape(path: Path, dyes: int | None = None) -> Shape:
    """(2, ny, nx) of the cells, from the headers alone.

    Raises BadInput for a missing or unknown key, a wrong dtype, shapes that differ, and a header that
    announces more than the file holds. Without `dyes`, amounts of any number of dyes will do.
    """
    with _open(path) as archive:
        _require_keys(path, [name.removesuffix(".npy") for name in archive.namelist()])
        shapes = {name: _shape_of(path, archive, name) for name in KEYS}
    cells = shapes["fibre"]
    if len(cells) != 3 or cells[0] != 2 or 0 in cells:
        limit = "(2, ny, nx): layer 0 the weft, layer 1 the warp"
        raise BadInput("wrong shape", file=str(path), field="fibre", value=cells, limit=limit)
    for name, shape in shapes.items():
        several = name in AMOUNTS and dyes != 1
        wanted = (dyes, *cells) if several and dyes is not None else cells
        if (shape[-3:] if several and dyes is None else shape) != wanted:
            limit = f"{wanted}, {'one for each dye' if several else 'the shape of fibre'}"
            raise BadInput("the shapes differ", file=str(path), field=name, value=shape, limit=limit)
    return cells


def load_arrays(path: Path, dyes: int) -> dict[str, NDArray[Any]]:
    """The arrays, C-contiguous, bool or float64, amounts (dyes, 2, ny, nx); pickles are never read."""
    cells = read_shape(path, dyes)
    arrays: dict[str, NDArray[Any]] = {}
    with np.load(path, allow_pickle=False) as file:
        for name, kinds in KEYS.items():
            try:
                array = np.ascontiguousarray(file[name], DTYPES[kinds])
            except (ValueError, zipfile.BadZipFile, OSError, EOFError) as error:
                raise BadInput(f"cannot be read: {error}", file=str(path), field=name) from None
            arrays[name] = array.reshape(dyes, *cells) if name in AMOUNTS else array
    return arrays


def _open(path: Path) -> zipfile.ZipFile:
    try:
        return zipfile.ZipFile(path)
    except (zipfile.BadZipFile, OSError) as error:
        remedy = "write it with numpy.savez"
        raise BadInput(f"not a readable .npz file: {error}", file=str(path), remedy=remedy) from None


def _require_keys(path: Path, names: list[str]) -> None:
    for name in KEYS:
        if name not in names:
            remedy = f"the file needs {', '.join(KEYS)}"
            raise BadInput("an array is missing", file=str(path), field=name, remedy=remedy)
    for name in names:
        if name not in KEYS:
            raise BadInput("unknown array", file=str(path), field=name, remedy=nearest(name, KEYS))


def _shape_of(path: Path, archive: zipfile.ZipFile, name: str) -> Shape:
    try:
        with archive.open(f"{name}.npy") as stream:
            version = np.lib.format.read_magic(stream)
            read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
            shape, _, dtype = read(stream)
            held = archive.getinfo(f"{name}.npy").file_size - stream.tell()
    except (ValueError, zipfile.BadZipFile, OSError, EOFError) as error:
        raise BadInput(f"not a numpy array: {error}", file=str(path), field=name) from None
    if dtype.kind not in KEYS[name]:
        raise BadInput("wrong dtype", file=str(path), field=name, value=str(dtype), limit=DTYPES[KEYS[name]])
    if math.prod(shape) * dtype.itemsize > held:
        problem = "holds less than its header says"
        raise BadInput(problem, file=str(path), field=name, value=shape, limit=f"{held} bytes")
    return tuple(shape)
