"""Each engine in a process of its own: what crashes, hangs or warns there is a mark, not the end."""

from __future__ import annotations

import importlib
import multiprocessing
import os
import signal
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from multiprocessing.connection import Connection
from typing import Any, Generic, TypeVar

import numpy as np

from nuno_bench.peers.problem import SECONDS, Peer
from nuno_bench.peers.table import Kind, Setting
from nuno_schemas.errors import RunFailed
from nuno_schemas.fabric import Float

S = TypeVar("S")
ENOUGH = 1 / 3
"""Of a setting's limit, after which its seconds are not repeated."""


@dataclass(frozen=True)
class Point(Generic[S]):
    """One engine at one setting, with a score of the kind S.

    start     from a fresh process to the first step: imports, the model, compiling [s]
    seconds   wall times of what is simulated, one per repeat [s]
    failure   why there is no score
    remark    what the engine says of the run
    """

    kind: str
    setting: str
    start: float | None = None
    seconds: tuple[float, ...] = ()
    score: S | None = None
    failure: str = ""
    remark: str = ""

    @property
    def median(self) -> float:
        return float(np.median(self.seconds)) if self.seconds else float("nan")


def fastest(points: Iterable[Point[S]], fits: Callable[[S], bool]) -> Point[S] | None:
    """Of those that have a score, and one that fits."""
    kept = (point for point in points if point.score is not None and fits(point.score))
    return min(kept, key=lambda point: point.median, default=None)


def is_ours(point: Point[Any]) -> bool:
    return point.kind.startswith("nuno-")


def times_ours(points: Iterable[Point[S]], point: Point[S], no_worse: Callable[[S], bool]) -> float | None:
    """How many times as long another engine takes as our fastest whose score is no worse than its.

    None for ours, for what has no score, and where none of ours is as good; that one is faster is not said then.
    """
    if point.score is None or is_ours(point):
        return None
    own = fastest(filter(is_ours, points), no_worse)
    return point.median / own.median if own is not None else None


def measure(
    kind: Kind, name: str, posed: object, judge: Callable[[Float], S], repeats: int, limit: float,
    simulated: float = SECONDS,
) -> Point[S]:  # fmt: skip
    """Run its setting of this name in a process of its own, ended after `limit` [s].

    `posed` is what the engine is made with, and `judge` scores what it advances to in `simulated` [s], or raises
    RunFailed where that is no cloth any more.
    """
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe(duplex=False)
    asked = (kind.module, kind.made, kind.settings[name], posed, repeats, limit, simulated)
    child = context.Process(target=work, args=(theirs, *asked), daemon=True)
    child.start()
    theirs.close()
    messages, failure, deadline = list[dict[str, Any]](), f"not done after {limit:g} s", time.monotonic() + limit
    try:
        while ours.poll(max(0.0, deadline - time.monotonic())):
            messages.append(ours.recv())
    except EOFError:
        child.join()
        code = child.exitcode or 0
        what = f"signal {signal.Signals(-code).name}" if code < 0 else f"exit code {code}"
        failure = f"its process ended with {what}" if code else ""
    finally:
        child.kill()
        child.join()
    failure = next((line["failure"] for line in messages if "failure" in line), failure)
    start = next((line["start"] for line in messages if "start" in line), None)
    done = [line for line in messages if "seconds" in line]
    if not done:
        return Point(kind.name, name, start, failure=failure)
    # What broke while it repeated itself has been measured all the same.
    remark = f"a repeat: {failure}" if failure else done[0]["remark"]
    point = Point[S](kind.name, name, start, tuple(line["seconds"] for line in done), remark=remark)
    if not np.isfinite(x := done[0]["x"]).all():
        return Point(**vars(point) | {"failure": "positions are no longer finite"})
    try:
        return Point(**vars(point) | {"score": judge(x)})
    except RunFailed as error:
        return Point(**vars(point) | {"failure": str(error)})


def work(
    tell: Connection, module: str, made: str, setting: Setting, posed: object, repeats: int, limit: float,
    simulated: float = SECONDS,
) -> None:  # fmt: skip
    """The process: make the engine, one short run that compiles, then the repeats; what is found is sent as it comes.

    Engines write lines of their own, which go nowhere.
    """
    began, nowhere = time.perf_counter(), os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 1)
    os.dup2(nowhere, 2)
    signal.alarm(int(limit) + 1)  # it ends by itself where whoever should end it was killed
    try:
        peer: Peer = getattr(importlib.import_module(module), made)(posed, **setting)
        peer.advance(1 / 60)
        tell.send({"start": time.perf_counter() - began})
        spent = 0.0
        for _ in range(repeats):
            peer.reset()
            at = time.perf_counter()
            x = peer.advance(simulated)
            spent += (seconds := time.perf_counter() - at)
            tell.send({"seconds": seconds, "remark": peer.remark, "x": x})
            if spent > ENOUGH * limit:
                break
    except Exception as error:  # whatever an engine raises is a finding about it
        tell.send({"failure": f"{type(error).__name__}: {error}"[:300]})
