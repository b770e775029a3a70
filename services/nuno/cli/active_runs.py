"""Commands on a run that goes on: top, topics, control."""

from __future__ import annotations

import argparse
import contextlib
import json
import sys
import time
from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import Any

from nuno.bus.health import Health, ask_health
from nuno.bus.messages import Bus
from nuno.bus.sessions import spoke
from nuno.cli.common import add_run, find_run
from nuno.formatting import factor
from nuno.runtime.driver import ACTIONS
from nuno.runtime.service import SUPERVISOR
from nuno.runtime.supervisor import control
from nuno_schemas.errors import BadInput

# `nuno control`: pause, resume, step, stop, change or add to a run that goes on.

SLOW = "the run answers when the frame that it is in is done"
NEEDS = {
    "set": ("KEY=VALUE", "set damping=0.5"),
    "add": ("a supply, a resist or an operation", "add 'supply: {kind: drop, place: [5 mm, 5 mm], diameter: 1 mm}'"),
}
"""Required argument of an action, and an example."""


def control_arguments(parser: argparse.ArgumentParser) -> None:
    add_run(parser, needed=True)
    parser.add_argument("action", choices=ACTIONS, help="what the run is to do, or is asked")
    parser.add_argument(
        "item",
        nargs="?",
        help="set: KEY=VALUE, e.g. gravity='[0, -1.6, 0]' or forces.wind.velocity='[5, 0, 0]'; step: how many frames; "
        "add: dye or resist, e.g. 'supply: {kind: drop, place: [5 mm, 5 mm], diameter: 1 mm}', or lines on cloth, "
        "e.g. 'wrinkle: {lines: [{points: [[0, 0, 0], [0.1, 0, 0]], height: 1 cm}]}', or what a body takes hold of "
        "and lets go, e.g. 'attach: {body: hand, within: 1 cm}', 'release: {body: hand}'",
    )


def control_command(args: argparse.Namespace) -> int:
    run, endpoint = find_run(args)
    request: dict[str, object] = {"action": args.action}
    if args.action in NEEDS:
        needed, example = NEEDS[args.action]
        if not args.item:
            raise BadInput(f"{args.action} needs {needed}", remedy=f"for example: nuno control last {example}")
        request["item"] = args.item
    if args.action == "step":
        if args.item is not None and not args.item.isdigit():
            remedy = "for example: nuno control last step 5"
            raise BadInput("step takes a number of frames", value=args.item, remedy=remedy)
        request["frames"] = int(args.item or 1)
    elif args.item is not None and "item" not in request:
        raise BadInput(f"{args.action} takes nothing more", value=args.item, remedy="leave it out")
    answer = control(run, endpoint, request, args.config, lambda: print(SLOW, file=sys.stderr, flush=True))
    if not answer.get("ok"):
        raise BadInput(str(answer.get("error", "refused")))
    print(f"{run}: {describe_answer(answer)}")
    return 0


def describe_answer(answer: Mapping[str, Any]) -> str:
    """Return a run's answer in words: its state, frame and time, and what was changed."""
    left, state = answer.get("left", 0), str(answer["state"])
    if left:
        state += f" for {left} {'frame' if left == 1 else 'frames'}, then paused;"
    text = f"{state} at frame {answer['frame']} of {answer['frames']}, t = {answer['t']:.3f} s"
    if "field" in answer:
        text = f"{answer['field']} {_short(answer['old'])} -> {_short(answer['new'])}; {text}"
    return text


def _short(value: object) -> str:
    if isinstance(value, dict):  # facts of an operation
        value = {name: int(n) if isinstance(n, float) and n.is_integer() else n for name, n in value.items()}
    text = "nothing" if value is None else json.dumps(value)
    return text if len(text) <= 60 else text[:57] + "..."


PATIENCE = 3.0
"""Longest wait for the run [s]."""
COLUMNS = (
    ("service", "service", ""), ("frame", "frame", ""), ("frames/s", "frames", ".1f"), ("behind", "behind", ""),
    ("ms", "late", ".0f"), ("out/s", "sent", ".1f"), ("out MB/s", "sent_megabytes", ".2f"), ("in/s", "received", ".1f"),
    ("in MB/s", "received_megabytes", ".2f"), ("waiting", "waiting", ""), ("missing", "missing", ""),
    ("refused", "refused", ""), ("CPU", "processor", ".0%"), ("memory", "memory", ""), ("process", "process", ""),
)  # fmt: skip
"""Heading, field of a line, and its format."""
Line = dict[str, Any]
"""Rates and counts of one service between two answers, as `compare` returns and --json prints them."""


def top_arguments(parser: argparse.ArgumentParser) -> None:
    add_run(parser)
    parser.add_argument("--once", action="store_true", help="measure for one interval, print that, and end")
    parser.add_argument("--interval", type=float, default=1.0, metavar="SECONDS", help="between two looks (default: 1)")
    parser.add_argument("--json", action="store_true", help="one line of JSON for each look")


def top_command(args: argparse.Namespace) -> int:
    """Show the run until it or the user ends this."""
    run, endpoint = find_run(args)

    def show(lines: list[Line]) -> str:
        return json.dumps({"run": run, "services": lines}) if args.json else f"{head(run, lines)}\n{table(lines)}"

    with spoke(endpoint, args.config) as session, contextlib.suppress(KeyboardInterrupt):
        pairs = filter(None, (compare(*pair) for pair in look(Bus(session, run, "top"), args.interval)))
        if args.once:
            lines = next(pairs, [])
            print(show(lines) if lines or args.json else f"{run} has ended")
        elif args.json or not sys.stdout.isatty():
            for lines in pairs:
                print(show(lines), end="\n" if args.json else "\n\n", flush=True)
        else:
            from rich.live import Live
            from rich.text import Text

            with Live(Text(f"{run}: looking ..."), auto_refresh=False, transient=False) as live:
                for shown in map(show, pairs):
                    live.update(Text(shown, no_wrap=True), refresh=True)
            print(f"{run} has ended")
    return 0


def look(bus: Bus, interval: float) -> Iterator[tuple[dict[str, Health], dict[str, Health]]]:
    """Yield the health of services at both ends of each interval [s] until the run ends. Raises BadInput."""
    if not 0.05 <= interval <= 3600.0:
        raise BadInput("no such interval", field="--interval", value=interval, limit="0.05 to 3600 s")
    end = time.monotonic() + PATIENCE
    while SUPERVISOR not in (present := bus.present()):
        if time.monotonic() > end:
            remedy = "nuno top without a name looks at the last one of this machine"
            raise BadInput("no such run goes on there", value=bus.run, remedy=remedy)
    before = ask_health(bus, present)
    while True:
        time.sleep(interval)
        if SUPERVISOR not in (present := bus.present()):
            return
        after = ask_health(bus, present)
        yield before, after
        before = after


def compare(before: Mapping[str, Health], after: Mapping[str, Health]) -> list[Line]:
    """Return a line for each service that answered twice; the leader is first.

    behind is the number of frames that it has not received yet, and late their time at the present rate [ms], None
    while the run stands still; frames, sent and received are rates [1/s]; processor is a share of one core, of the
    whole process.
    """
    both = sorted((h for h in after.values() if h.service in before), key=lambda h: (not h.leads, h.service))
    leader = max((h for h in both if h.leads), key=lambda h: h.frame, default=None)
    pace = rate(before[leader.service], leader, "frames") if leader is not None else 0.0
    lines: list[Line] = []
    for now in both:
        rates = {name: rate(before[now.service], now, name) for name in ("frames", "sent", "received", "processor")}
        behind = max(0, leader.frame - now.frame) if leader is not None and now.frame >= 0 else 0
        lines.append({
            "service": now.service, "leads": now.leads, "frame": now.frame, "t": now.t,
            "frames": rates["frames"] if now.frame >= 0 else 0.0, "behind": behind,
            "late": 0.0 if not behind else 1e3 * behind / pace if pace > 0.0 else None,
            "sent": rates["sent"], "sent_megabytes": rate(before[now.service], now, "sent_bytes") / 1e6,
            "received": rates["received"],
            "received_megabytes": rate(before[now.service], now, "received_bytes") / 1e6,
            "waiting": now.waiting, "missing": now.missing, "refused": now.refused,
            "processor": rates["processor"], "memory": now.memory, "process": f"{now.host}:{now.pid}",
        })  # fmt: skip
    return lines


def rate(old: Health, now: Health, name: str) -> float:
    """Return the change of a count in a second."""
    seconds = now.time - old.time
    return (getattr(now, name) - getattr(old, name)) / seconds if seconds > 0.0 else 0.0


def head(run: str, lines: list[Line]) -> str:
    """Return the run's frame, time and speed in words."""
    first = lines[0]
    if not first["leads"]:
        return f"{run}: before its first frame"
    speed = first["frames"] * first["t"] / first["frame"] if first["frame"] > 0 else 0.0
    pace = f"{first['frames']:.1f} frames/s, {factor(speed)} real time" if first["frames"] else "standing still"
    return f"{run}: frame {first['frame']}, t = {first['t']:.3f} s; {pace}"


def table(lines: list[Line]) -> str:
    """Return aligned columns; services of one process share its processor time and memory, shown at the first."""
    rows, seen = [[heading for heading, _, _ in COLUMNS]], set[str]()
    for line in lines:
        shown = line | {"memory": f"{line['memory'] / 2**20:.0f} MiB"}
        if line["frame"] < 0:
            shown |= {"frame": None, "late": None}
        cells = ["-" if shown[key] is None else format(shown[key], spec) for _, key, spec in COLUMNS]
        if line["process"] in seen:
            cells[-3:-1] = '"', '"'
        seen.add(line["process"])
        rows.append(cells)
    return align(rows, (0, len(COLUMNS) - 1))


def align(rows: Sequence[Sequence[str]], left: Collection[int] = (0,)) -> str:
    """Align cells in columns, flush right, those of `left` flush left."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    sides = [str.ljust if i in left else str.rjust for i in range(len(widths))]
    padded = ([side(cell, width) for side, cell, width in zip(sides, row, widths, strict=True)] for row in rows)
    return "\n".join("  ".join(cells).rstrip() for cells in padded)


# `nuno topics`: the topics that a run publishes on its bus.

TOPIC_HEADINGS = ("topic", "type", "encoding", "by", "messages", "bytes each", "a second", "MB/s")


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
    lines = compare_topics(*pair)
    if args.json:
        print(json.dumps({"run": run, "endpoint": endpoint, "topics": lines}))
    else:
        print(f"zenoh at {endpoint}, keys {bus.key('TOPIC')}")
        print(align([TOPIC_HEADINGS, *map(_topic_cells, lines)], range(4)))
    return 0


def _topic_cells(line: Line) -> list[str]:
    """Return the cells of a line under HEADINGS."""
    size = f"{line['size']:,.0f}" if line["messages"] else "-"
    texts = [line[name] for name in ("topic", "type", "encoding", "service")]
    return [*texts, f"{line['messages']:,}", size, f"{line['rate']:.1f}", f"{line['megabytes']:.3f}"]


def compare_topics(before: Mapping[str, Health], after: Mapping[str, Health]) -> list[Line]:
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
