"""`nuno bench capacity`: bytes a frame, what the bus carries, and how many frames and hosts follow from both."""

from __future__ import annotations

import argparse
import tempfile
import threading
import time
from collections import defaultdict
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import zenoh

import nuno
from nuno.access import folder
from nuno.wire.bus import Bus
from nuno.wire.sessions import free_port, hub, spoke
from nuno_bench import machine, options
from nuno_bench.report import markdown
from nuno_bench.report.result import number, text_table
from nuno_bench.soak import small
from nuno_schemas.messages import CHECKPOINT, FABRIC, GEOMETRY, STATE

FRAMES, RATE = 20, 50
"""Frames of each measured run, and frames in a simulated second."""
HEADER = 150
"""Bytes of a message's header, as JSON, about."""
READERS = 2
"""Services that read every frame's positions in a run without a viewer: recorder and collision."""
LINKS = {"100 Mbit/s": 100e6 / 8, "1 Gbit/s": 1e9 / 8, "10 Gbit/s": 10e9 / 8}
WATCHED = "1 Gbit/s"
LARGER = (10_000, 100_000, 1_000_000)
"""Vertices that are extrapolated to."""
PIECE = 1_000_000
SECTION = "capacity"


@dataclass(frozen=True)
class Size:
    """What one frame of a sheet is made of [bytes]."""

    vertices: int
    state: float
    """Positions."""
    rest: float
    """All else that comes with every frame: status, bodies, report, acknowledgements, headers."""
    fabric: float
    """What is sent once: the cloth."""
    checkpoint: float
    """A whole state in float64."""
    file: float
    """Of the recording, compressed, for a frame."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--sizes", default="16,64,128,256", metavar="A,B", help="vertices along a side (%(default)s)")
    parser.add_argument("--megabytes", type=int, default=300, metavar="N", help="sent to measure the bus (%(default)s)")
    options.add_shared(parser, "--docs")


def main(args: argparse.Namespace) -> int:
    if args.docs is not None:
        markdown.check_section(args.docs, SECTION)
    sides = [int(side) for side in options.names_of(args.sizes)]
    with tempfile.TemporaryDirectory(prefix="nuno-capacity-") as name:
        sizes = [measure(Path(name), side) for side in sides]
        others = machine.Others()
        rates = {kind: throughput(Path(name), kind == "TLS", args.megabytes) for kind in ("TCP", "TLS")}
    tables = [size_table(sizes), bus_table(rates), link_table(*law(sizes), rates["TLS"])]
    for headings, rows in tables:
        print(text_table(headings, rows), end="\n\n")
    if args.docs is not None:
        text = describe_law(*law(sizes))
        parts = [markdown.table(*tables[0]), text, *(markdown.table(*each) for each in tables[1:])]
        facts = {
            "command": f"nuno bench capacity --sizes {args.sizes}",
            **machine.describe(),
            "load": others.describe(),
        }
        markdown.replace_section(args.docs, SECTION, [*parts, markdown.facts(facts)])
    return 0


def measure(where: Path, side: int) -> Size:
    """Bytes of each kind of message of side x side vertices, from a recording."""
    scene = small.write(where, FRAMES / RATE, side)
    path = where / f"sheet-{side}.mcap"
    nuno.run(scene, record=path)
    total: dict[str, int] = defaultdict(int)
    count: dict[str, int] = defaultdict(int)
    with nuno.open(path) as recording:
        for message in recording.messages():
            total[message.topic] += len(message.payload) + HEADER
            count[message.topic] += 1
    apart = (FABRIC.name, GEOMETRY.name, CHECKPOINT.name, STATE.name)
    frames = count[STATE.name]
    every = sum(size for topic, size in total.items() if topic not in apart and count[topic] >= frames - 1)
    each = {topic: total[topic] / max(1, count[topic]) for topic in total}
    file = path.stat().st_size / frames
    return Size(side**2, each[STATE.name], every / frames, each[FABRIC.name], each.get(CHECKPOINT.name, 0.0), file)


def law(sizes: Sequence[Size]) -> tuple[float, float]:
    """Bytes a frame as a + b n over n vertices, by least squares: a, b."""
    n = np.array([size.vertices for size in sizes], float)
    y = np.array([size.state + size.rest for size in sizes])
    b, a = np.polyfit(n, y, 1)
    return float(a), float(b)


@contextmanager
def _sessions(where: Path, secure: bool) -> Iterator[tuple[zenoh.Session, zenoh.Session]]:
    """Two sessions that a hub joins, all in this process."""
    endpoint = f"{'tls' if secure else 'tcp'}/127.0.0.1:{free_port()}"
    config = dict.fromkeys(("router", "simulation", "recorder"))
    if secure:
        folder.make(where / "certs", ("127.0.0.1",), list(config), 1)
        config = {role: str(where / "certs" / f"{role}.json5") for role in config}
    with (
        hub(endpoint, config["router"]),
        spoke(endpoint, config["simulation"]) as one,
        spoke(endpoint, config["recorder"]) as other,
    ):
        yield one, other


def throughput(where: Path, secure: bool, megabytes: int) -> float:
    """Bytes a second from one client of a router to another, in messages of 1 MB, nothing shared and nothing lost."""
    arrived, done = 0, threading.Event()

    def take(sample: zenoh.Sample) -> None:
        nonlocal arrived
        arrived += len(sample.payload)
        if arrived > megabytes * PIECE:
            done.set()

    with _sessions(where, secure) as (one, other):
        kept = other.declare_subscriber(Bus(other, "capacity", "recorder").key("**"), take)
        publisher = Bus(one, "capacity", "simulation").publisher(STATE)
        while not arrived:  # the router has to hear of the subscriber first
            publisher.put(b"first")
            time.sleep(0.01)
        begin = time.perf_counter()
        for _ in range(megabytes):
            publisher.put(bytes(PIECE))
        if not done.wait(300.0):
            raise TimeoutError("not all that was sent has arrived")
        rate = megabytes * PIECE / (time.perf_counter() - begin)
        kept.undeclare()
    return rate


def size_table(sizes: Sequence[Size]) -> tuple[list[str], list[list[str]]]:
    """Bytes of what was measured."""
    headings = ["vertices", "positions a frame", "all else a frame", "cloth, once", "checkpoint", "file a frame"]
    rows = [
        [f"{size.vertices:,}", *(_bytes(x) for x in (size.state, size.rest, size.fabric, size.checkpoint, size.file))]
        for size in sizes
    ]
    return headings, rows


def bus_table(rates: dict[str, float]) -> tuple[list[str], list[list[str]]]:
    """What a router passes on."""
    return ["client - router - client", "MB/s"], [[kind, number(1e-6 * rate)] for kind, rate in rates.items()]


def link_table(a: float, b: float, router: float) -> tuple[list[str], list[list[str]]]:
    """Frames a second over links, and how many may watch, extrapolated."""
    headings = [
        "vertices",
        "bytes a frame",
        *(f"frames/s, {link}" for link in LINKS),
        "observers, 1 Gbit/s, 50 frames/s",
    ]
    rows = []
    for vertices in LARGER:
        frame = a + b * vertices
        rates = [min(link, router) / (frame * READERS) for link in LINKS.values()]
        watch = int(min(LINKS["1 Gbit/s"], router) / (frame * RATE)) - READERS
        row = [
            f"{vertices:,}",
            _bytes(frame),
            *map(number, rates),
            str(watch) if watch >= 0 else "none: too few frames",
        ]
        rows.append(row)
    return headings, rows


def describe_law(a: float, b: float) -> str:
    """The fit in words."""
    return f"A frame of n vertices takes {a:.0f} + {b:.2f} n bytes (least squares over these sizes)."


def _bytes(value: float) -> str:
    if value < 1e3:
        return f"{value:.0f} B"
    return f"{number(value / 1e3)} kB" if value < 1e6 else f"{number(value / 1e6)} MB"
