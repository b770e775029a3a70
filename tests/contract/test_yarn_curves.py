"""Yarns as curves: segments never reach from one yarn to the next."""

import numpy as np

from nuno_schemas.operation import YarnCurves


def make_curves(sizes):
    n = sum(sizes)
    ptr = np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64)
    return YarnCurves(
        np.zeros((n, 3)), ptr, np.zeros(len(sizes)), np.zeros(len(sizes), np.int32), ("yarn",), np.zeros((n, 3))
    )


def test_segments_stay_within_their_yarn():
    curves = make_curves([3, 1, 0, 2])
    assert curves.number == 4
    assert curves.segments().tolist() == [0, 1, 4]
    assert curves.yarn().tolist() == [0, 0, 0, 1, 3, 3]


def test_no_yarns_have_no_segments():
    assert len(make_curves([]).segments()) == 0
