"""Changes to messages: to the arrays and the text that they hold, or to their bytes."""

from __future__ import annotations

import json
from random import Random
from typing import Any

import numpy as np

from nuno.wire.arrays import BadMessage, decode_arrays, encode_arrays
from nuno_bench.soak.fuzz.mutate_text import mutate_bytes, mutate_text

WORDS = (
    "null", "true", "[]", "{}", "-1", "1e400", "NaN", "Infinity", '""', '"\\ud800"', '"frame":', '"t":', '"run":',
    '"action":"step"', '"action":"set"', '"action":"add"', '"frames":1e9', '"item":"solver.dt=1"', '"state":"done"',
    "9" * 5000, '"args":{}', '"expected":{"a":-1}', '"lines":', '"points":', '"height":', '"do":"check"', '"shape":0',
)  # fmt: skip
VALUES = (float("nan"), float("inf"), -1.0, 0.0, 1e308, 2.0**40, 1.0)


def mutate_json(data: bytes, random: Random) -> bytes:
    return mutate_text(data, random, WORDS)


def mutate_arrays(data: bytes, random: Random) -> bytes:
    """A change to one array, or to the text; to bytes where it holds none."""
    if random.random() < 0.25:
        return mutate_bytes(data, random)
    try:
        arrays, text = decode_arrays(data)
    except BadMessage:
        return mutate_bytes(data, random)
    if not arrays or random.random() < 0.3:
        changed = mutate_json(json.dumps(text).encode(), random)
        try:
            text = dict(json.loads(changed))
        except (ValueError, TypeError, RecursionError):
            return mutate_bytes(data, random)
        return encode_arrays(arrays, text)
    name = random.choice(list(arrays))
    how = random.randrange(7)
    if how == 0:
        del arrays[name]
    elif how == 1:
        arrays[random.choice(("x", "other", *arrays))] = arrays[name]
    else:
        arrays[name] = _changed(arrays[name], how, random)
    return encode_arrays(arrays, text)


def _changed(values: np.ndarray[Any, Any], how: int, random: Random) -> np.ndarray[Any, Any]:
    if how == 2:
        kind = random.choice(("float64", "float32", "int64", "int32", "uint8", "int8", "bool"))
        with np.errstate(all="ignore"):
            return values.astype(kind)
    if how == 3:
        return values[: random.randrange(len(values) + 1)] if values.ndim else values.reshape(1)
    if how == 4:
        return values.reshape(-1) if random.random() < 0.5 else values[None]
    if how == 5:
        return np.concatenate([values, values]) if values.ndim else np.stack([values, values])
    new = values.copy()
    if new.size:
        with np.errstate(all="ignore"):
            new.flat[random.randrange(new.size)] = np.float64(random.choice(VALUES)).astype(new.dtype)
    return new
