"""`nuno topics`: what a run that goes on publishes on its bus, for whoever wants to listen."""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass

from nuno.cli.common import add_run, find_run
from nuno.cli.top import look
from nuno.top import align
from nuno.wire.bus import Bus
from nuno.wire.health import Health
from nuno.wire.sessions import spoke

HEADINGS = ("topic", "type", "encoding", "by", "messages", "bytes each", "a second", "MB/s")


@dataclass(frozen=True)
class TopicLine:
    """One topic of one service: messages and their mean size [bytes] since its start, and what went out in a second
    of the time that it was looked at.
    """

    topic: str
    type: str
    encoding: str
    service: str
    messages: int
    size: float
    rate: float
    megabytes: float

    def cells(self) -> list[str]:
        """Under HEADINGS."""
        told = [self.topic, self.type, self.encoding, self.service, f"{self.messages:,}"]
        return [*told, f"{self.size:,.0f}" if self.messages else "-", f"{self.rate:.1f}", f"{self.megabytes:.3f}"]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_run(parser)
    parser.add_argument("--interval", type=float, default=1.0, metavar="SECONDS", help="that rates are of (default: 1)")
    parser.add_argument("--json", action="store_true", help="one line of JSON")


def main(args: argparse.Namespace) -> int:
    """Look at the run for one interval."""
    run, endpoint = find_run(args)
    with spoke(endpoint, args.config) as session:
        bus = Bus(session, run, "topics")
        pair = next(look(bus, args.interval), None)
    if pair is None:
        print(f"{run} has ended")
        return 0
    lines = compare(*pair)
    if args.json:
        print(json.dumps({"run": run, "endpoint": endpoint, "topics": [asdict(line) for line in lines]}))
    else:
        print(f"zenoh at {endpoint}, keys {bus.key('TOPIC')}")
        print(align([HEADINGS, *(line.cells() for line in lines)], range(4)))
    return 0


def compare(before: Mapping[str, Health], after: Mapping[str, Health]) -> list[TopicLine]:
    """A line for each topic of each service that answered twice, in the order of their names."""
    lines = []
    for name in before.keys() & after.keys():
        seconds = after[name].time - before[name].time
        old = {one.topic: one for one in before[name].topics}
        for now in after[name].topics:
            sent, size = (
                getattr(now, count) - (getattr(old[now.topic], count) if now.topic in old else 0)
                for count in ("sent", "sent_bytes")
            )
            mean = now.sent_bytes / now.sent if now.sent else 0.0
            rates = (sent / seconds, size / seconds / 1e6) if seconds > 0.0 else (0.0, 0.0)
            lines.append(TopicLine(now.topic, now.type, now.encoding, name, now.sent, mean, *rates))
    return sorted(lines, key=lambda line: (line.topic, line.service))
