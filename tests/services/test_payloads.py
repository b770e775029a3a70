"""Payloads that are cut, changed or lie about themselves never decode to something else."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from nuno.bus.encodings import BadMessage, check_protobuf, decode_arrays, decode_points, encode_arrays, encode_points
from nuno.collision.messages import decode_geometry, decode_poses


def test_payloads_that_are_cut_or_changed_never_decode_to_something_else() -> None:
    """Every prefix of a real payload is refused, whichever byte it is cut at."""
    arrays = encode_arrays({"rotation": np.array([[1.0, 0, 0, 0]]), "translation": np.zeros((1, 3))}, {"t": 0.5})
    points = encode_points(np.arange(12.0).reshape(4, 3), 0.5)
    for payload, decode in ((arrays, decode_arrays), (arrays, decode_poses), (points, decode_points)):
        decode(payload)
        check_protobuf(payload)
        refused = 0
        for end in range(len(payload)):
            try:
                decode(payload[:end])  # type: ignore[operator]
            except BadMessage:
                refused += 1
            else:
                # A cut between two fields is a whole protobuf message, of less.
                check_protobuf(payload[:end] or payload)
        assert refused > 0.9 * len(payload)


def test_arrays_that_lie_about_themselves_are_refused() -> None:
    from nuno.bus.encodings import _arrays_class

    def message(text: str = "{}", **array: Any) -> bytes:
        found = _arrays_class()(text=text)
        if array:
            found.arrays.add(**array)
        return bytes(found.SerializeToString())

    huge = 2**32 - 1
    for payload in (
        message(name="x", dtype="object", shape=[1], data=b"12345678"),
        message(name="x", dtype="float64", shape=[2], data=b"12345678"),
        message(name="x", dtype="float64", shape=[huge] * 4, data=b""),
        message(name="x", dtype="float64", shape=[huge, huge, huge, 0], data=b""),
        message(name="x", dtype="float64", shape=[1] * 100, data=b"12345678"),
        message(text="[]"),
        message(text="nonsense"),
        message(text="[" * 100_000),
    ):
        with pytest.raises(BadMessage):
            decode_arrays(payload)
    for text in ('{"t": null}', '{"t": "x"}', '{"t": 0, "bodies": 7, "frames": 7}'):
        for decode in (decode_poses, decode_geometry):
            with pytest.raises(BadMessage):
                decode(message(text, name="rotation", dtype="float64", shape=[0, 4], data=b""))
