"""What a net's yarns must be: runs of springs, each sharing a vertex with the next, none used twice."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from nuno_kernels.npz_file import require_values
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Float, Int


def check_yarns(path: Path, springs: Int, links: Int, ptr: Int, mu: Float) -> None:
    """Raises BadInput, with key and index, for yarns (links (l,), ptr (y + 1,), mu (y,)) of springs (s, 2) that are
    none: see nuno_schemas.fabric.Yarns.
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
    for at, wanted in ((0, 0), (-1, links.shape[0])):
        if ptr[at] != wanted:
            place = at % ptr.shape[0]
            problem = "yarns begin with the first link and end with the last"
            raise BadInput(problem, file=str(path), field=f"yarn_ptr[{place}]", value=int(ptr[at]), limit=f"{wanted}")
    rising = np.concatenate([[True], np.diff(ptr) > 0])
    require_values(path, "yarn_ptr", ptr, rising, "a yarn has no link", "more than the one before")


def _check_chains(path: Path, springs: Int, links: Int, ptr: Int) -> None:
    """Each link shares one vertex with the next, and leaves by the other one than it came by."""
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
    """A spring belongs to one yarn, once; a ring names its first link again at its end."""
    first, last = ptr[:-1], ptr[1:] - 1
    counted = np.ones(links.shape[0], bool)
    counted[last[(links[first] == links[last]) & (last >= first + 3)]] = False
    places = np.flatnonzero(counted)
    order = places[np.argsort(links[places], kind="stable")]
    once = np.ones(links.shape[0], bool)
    once[order[1:][links[order[1:]] == links[order[:-1]]]] = False
    problem, remedy = "the spring is a link already", "a ring of three links or more ends with its first link"
    require_values(path, "yarn_links", links, once, problem, "each spring once", remedy)
