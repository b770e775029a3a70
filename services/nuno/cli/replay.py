"""`nuno replay`: publish a recording again, and show it."""

from __future__ import annotations

import argparse
import contextlib
import re
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

from nuno.bus.health import Watch, offer_health
from nuno.bus.messages import Bus
from nuno.bus.sessions import hub_at
from nuno.cli.common import add_config, add_flags, warn
from nuno.formatting import plain
from nuno.process import state_of
from nuno.recording.reader import Recording, open_recording
from nuno.replay.publisher import Replay
from nuno.runtime import runs
from nuno.runtime.service import SUPERVISOR, Options, run_service
from nuno.scene.recorded_scene import restored_scene
from nuno.scene.scene_file import Loaded
from nuno.viewer.live import keep_page
from nuno.viewer.require import add_view, choose_view
from nuno_schemas.errors import BadInput


def replay_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("recording", type=Path, metavar="FILE", help="a recording, or last")
    speed = parser.add_mutually_exclusive_group()
    speed.add_argument("--rate", type=float, default=1.0, metavar="X", help="simulated seconds a second (default: 1)")
    speed.add_argument("--fast", action="store_true", help="as fast as the subscribers take it")
    parser.add_argument("--loop", action="store_true", help="begin again at the end, until interrupted")
    add_view(parser, "only publish")
    add_flags(parser, {
        "--start": ("SECONDS", "begin at this simulation time", float),
        "--listen": ("ENDPOINT", "where subscribers connect (default: a free port on loopback)"),
        "--run": ("ID", "name of the run it is published as"),
    })  # fmt: skip
    parser.set_defaults(start=0.0)
    add_config(parser)


def replay_command(args: argparse.Namespace) -> int:
    with open_recording(runs.find_recording(args.recording)) as recording:
        warn(recording)
        return _replay(recording, args)


def _replay(recording: Recording, args: argparse.Namespace) -> int:
    view = choose_view(args)
    if args.loop and args.save:
        raise BadInput("a loop has no end to save", field="--save", remedy="leave --loop out")
    name = "replay-" + re.sub(r"[^A-Za-z0-9_.-]+", "-", str(recording.scene.get("name", "run")))[:64]
    run = runs.new_id(name) if args.run is None else runs.check_id(args.run)
    shown = view is not None or args.save is not None
    options = Options(view=view, save=args.save, must_see=("viewer",) if args.save else ())
    replay = Replay(None if args.fast else args.rate, args.start, args.loop, options.must_see)
    replay.check(recording)
    with contextlib.ExitStack() as stack:
        session, endpoint = stack.enter_context(hub_at(args.listen, args.config))
        stack.enter_context(runs.announced(run, endpoint))
        bus = Bus(session, run, SUPERVISOR)
        offer_health(bus)
        stack.enter_context(bus.alive())
        if shown:
            stack.enter_context(_viewer(stack.enter_context(restored_scene(recording)), bus, options))
        print(plain(f"replaying {recording.path} as {run} at {endpoint}"), file=sys.stderr)
        ended = ""
        try:
            replay.run(bus, recording)
        except KeyboardInterrupt as signal:
            ended = state_of(signal)
    total = sum(replay.sent.values())
    print(f"{total} messages, {replay.frames} frames")
    if ended:
        print(f"{ended} before the end of the recording", file=sys.stderr)
    return int(bool(ended))


@contextlib.contextmanager
def _viewer(loaded: Loaded, bus: Bus, options: Options) -> Iterator[None]:
    """The viewer service, in a thread, for one replay."""
    work = ("viewer", loaded, bus.session, bus.run, options)
    thread = threading.Thread(target=run_service, args=work, daemon=True)
    thread.start()
    if Watch(bus).wait_for({"viewer"}, 60.0):
        raise BadInput("the viewer did not start")
    yield
    answer = bus.ask_json("finish/viewer", {}, 30.0)
    thread.join(10.0)
    if answer.get("file"):
        print(f"rerun file {answer['file']}")
    keep_page(options.view, answer)
