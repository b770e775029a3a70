"""Arrays of cells from a .npz file: sizes from its headers first, so that nothing is allocated for a lie."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nuno_kernels.npz_file import NpzFile, open_npz
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
    with open_npz(path) as file:
        return _read_shape(file, dyes)


def _read_shape(file: NpzFile, dyes: int | None) -> Shape:
    path = file.path
    _require_keys(path, file.names)
    shapes = {name: _shape_of(file, name) for name in KEYS}
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
    arrays: dict[str, NDArray[Any]] = {}
    with open_npz(path) as file:
        cells = _read_shape(file, dyes)
        for name, kinds in KEYS.items():
            array = np.ascontiguousarray(file.array(name), DTYPES[kinds])
            arrays[name] = array.reshape(dyes, *cells) if name in AMOUNTS else array
    return arrays


def _require_keys(path: Path, names: list[str]) -> None:
    for name in KEYS:
        if name not in names:
            remedy = f"the file needs {', '.join(KEYS)}"
            raise BadInput("an array is missing", file=str(path), field=name, remedy=remedy)
    for name in names:
        if name not in KEYS:
            raise BadInput("unknown array", file=str(path), field=name, remedy=nearest(name, KEYS))


def _shape_of(file: NpzFile, name: str) -> Shape:
    header = file.header(name)
    if header.dtype.kind not in KEYS[name]:
        limit = DTYPES[KEYS[name]]
        raise BadInput("wrong dtype", file=str(file.path), field=name, value=str(header.dtype), limit=limit)
    header.check(file.path, name)
    return header.shape
