"""`nuno control`: pause, resume, step, stop or change a run that goes on."""

from __future__ import annotations

import argparse

from nuno import runs
from nuno.cli.common import add_config
from nuno.supervisor import control
from nuno_schemas.errors import BadInput


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("run", help="a run's id or its beginning, or last")
    parser.add_argument("action", choices=["status", "pause", "resume", "step", "stop", "set"])
    parser.add_argument("item", nargs="?", help="set: KEY=VALUE, e.g. gravity='[0, -1.6, 0]'; step: how many frames")
    parser.add_argument("--connect", metavar="ENDPOINT", help="the run's hub, if it is on another host")
    add_config(parser)


def main(args: argparse.Namespace) -> int:
    run, endpoint = (args.run, args.connect) if args.connect else runs.find(args.run)
    request: dict[str, object] = {"action": args.action}
    if args.action == "set":
        if not args.item:
            raise BadInput("set needs KEY=VALUE", remedy="for example: nuno control last set damping=0.5")
        request["item"] = args.item
    if args.action == "step":
        if args.item is not None and not args.item.isdigit():
            raise BadInput("step takes a number of frames", value=args.item)
        request["frames"] = int(args.item or 1)
    answer = control(run, endpoint, request, args.config)
    if not answer.get("ok"):
        raise BadInput(str(answer.get("error", "refused")))
    print(f"{run}: {answer['state']} at frame {answer['frame']} of {answer['frames']}, t = {answer['t']:.3f} s")
    return 0
