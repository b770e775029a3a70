"""`nuno control`: pause, resume, step, stop, change or add to a run that goes on."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Mapping
from typing import Any

from nuno.cli.common import add_run, find_run
from nuno.runtime.driver import ACTIONS
from nuno.runtime.supervisor import control
from nuno_schemas.errors import BadInput

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
    print(f"{run}: {describe(answer)}")
    return 0


def describe(answer: Mapping[str, Any]) -> str:
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
