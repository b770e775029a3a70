"""`nuno top`: what the services of a run that goes on are doing."""

from __future__ import annotations

import argparse
import contextlib
import json
import sys
import time
from collections.abc import Iterator

from nuno.cli.common import add_run, find_run
from nuno.service import SUPERVISOR
from nuno.top import ServiceLine, as_json, compare, head, table
from nuno.wire.bus import Bus
from nuno.wire.health import Health, ask_health
from nuno.wire.sessions import spoke
from nuno_schemas.errors import BadInput

PATIENCE = 3.0
"""How long the run is waited for [s]."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_run(parser)
    parser.add_argument("--once", action="store_true", help="measure for one interval, print that, and end")
    parser.add_argument("--interval", type=float, default=1.0, metavar="SECONDS", help="between two looks (default: 1)")
    parser.add_argument("--json", action="store_true", help="one line of JSON for each look")


def main(args: argparse.Namespace) -> int:
    """Look at the run until it ends or the user has seen enough."""
    run, endpoint = find_run(args)
    with spoke(endpoint, args.config) as session, contextlib.suppress(KeyboardInterrupt):
        looks = filter(None, (compare(*pair) for pair in look(Bus(session, run, "top"), args.interval)))
        if args.once:
            _print(run, next(looks, []), as_text=not args.json)
        elif args.json or not sys.stdout.isatty():
            for lines in looks:
                _print(run, lines, as_text=not args.json)
        else:
            _show(run, looks)
            print(f"{run} has ended")
    return 0


def look(bus: Bus, interval: float) -> Iterator[tuple[dict[str, Health], dict[str, Health]]]:
    """What services tell at both ends of each interval [s] until the run ends. Raises BadInput where there is none."""
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


def _print(run: str, lines: list[ServiceLine], as_text: bool) -> None:
    if not as_text:
        print(json.dumps(as_json(run, lines)), flush=True)
    elif lines:
        print(head(run, lines), table(lines), "", sep="\n", flush=True)
    else:
        print(f"{run} has ended")


def _show(run: str, looks: Iterator[list[ServiceLine]]) -> None:
    """In place, on a terminal."""
    from rich.live import Live
    from rich.text import Text

    with Live(Text(f"{run}: looking ..."), auto_refresh=False, transient=False) as live:
        for lines in looks:
            live.update(Text(f"{head(run, lines)}\n{table(lines)}", no_wrap=True), refresh=True)
