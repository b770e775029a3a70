"""`nuno topics`: the topics that a run publishes on its bus."""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping

from nuno.bus.health import Health
from nuno.bus.messages import Bus
from nuno.bus.sessions import spoke
from nuno.cli.common import add_run, find_run
from nuno.cli.top import Line, align, look

HEADINGS = ("topic", "type", "encoding", "by", "messages", "bytes each", "a second", "MB/s")


def topics_arguments(parser: argparse.ArgumentParser) -> None:
    add_run(parser)
    parser.add_argument("--interval", type=float, default=1.0, metavar="SECONDS", help="that rates are of (default: 1)")
    parser.add_argument("--json", action="store_true", help="one line of JSON")


def topics_command(args: argparse.Namespace) -> int:
    """Measure the run for one interval."""
    run, endpoint = find_run(args)
    with spoke(endpoint, args.config) as session:
        bus = Bus(session, run, "topics")
        pair = next(look(bus, args.interval), None)
    if pair is None:
        print(f"{run} has ended")
        return 0
    lines = compare(*pair)
    if args.json:
        print(json.dumps({"run": run, "endpoint": endpoint, "topics": lines}))
    else:
        print(f"zenoh at {endpoint}, keys {bus.key('TOPIC')}")
        print(align([HEADINGS, *map(_cells, lines)], range(4)))
    return 0


def _cells(line: Line) -> list[str]:
    """Return the cells of a line under HEADINGS."""
    size = f"{line['size']:,.0f}" if line["messages"] else "-"
    texts = [line[name] for name in ("topic", "type", "encoding", "service")]
    return [*texts, f"{line['messages']:,}", size, f"{line['rate']:.1f}", f"{line['megabytes']:.3f}"]


def compare(before: Mapping[str, Health], after: Mapping[str, Health]) -> list[Line]:
    """Return a line for each topic of each service that answered twice, in the order of their names.

    messages and their mean size [bytes] are since the service's start, rate and megabytes are per second.
    """
    lines: list[Line] = []
    for name in before.keys() & after.keys():
        seconds = after[name].time - before[name].time
        old = {one.topic: (one.sent, one.sent_bytes) for one in before[name].topics}
        for now in after[name].topics:
            sent, size = old.get(now.topic, (0, 0))
            lines.append({
                "topic": now.topic, "type": now.type, "encoding": now.encoding, "service": name, "messages": now.sent,
                "size": now.sent_bytes / now.sent if now.sent else 0.0,
                "rate": (now.sent - sent) / seconds if seconds > 0.0 else 0.0,
                "megabytes": (now.sent_bytes - size) / seconds / 1e6 if seconds > 0.0 else 0.0,
            })  # fmt: skip
    return sorted(lines, key=lambda line: (line["topic"], line["service"]))
