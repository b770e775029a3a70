"""`nuno serve`: one service, to run services by hand or in containers; `nuno certs`: certificates for several hosts."""

from __future__ import annotations

import argparse
import os
import shlex
import signal
import sys
import threading
import time
from pathlib import Path

import zenoh

from nuno.bus import credentials, sessions
from nuno.bus.credentials import Kept
from nuno.bus.sessions import LOOK_SECONDS, SlowConsumers
from nuno.cli.common import add_config, add_flags, add_set
from nuno.plugin_contract import containment
from nuno.process import ENDING, SIGNALS, end_process
from nuno.runtime import runs
from nuno.runtime.launch import FINISH_TIMEOUT, LINGER
from nuno.runtime.service import MODULES, SUPERVISOR, Options, run_service
from nuno.scene import scene_file, shipped
from nuno.simulation.solver_selection.cloth import decide
from nuno.simulation.solver_selection.trials import Budget
from nuno_schemas.errors import BadInput, RunFailed

LISTEN = "tcp/127.0.0.1:7447"
PATIENCE = 20.0
"""Longest wait of a service for its hub [s]: containers start in any order."""
NO_END = 1e7
"""Budget of the trials of a solver [s]."""
KEEPERS = ("recorder", "viewer")
"""Services that close a file at their end."""


def serve_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("service", choices=["router", *MODULES], help="which one")
    parser.add_argument("scene", nargs="?", help="the run's scene (not for the router)")
    add_config(parser)
    add_set(parser, "change a field of the scene; may be repeated")
    add_flags(parser, {
        "--run": ("ID", "the run that this service belongs to; router: whose services it waits for alone"),
        "--connect": ("ENDPOINT", "the hub, e.g. tcp/127.0.0.1:7447"),
        "--listen": ("ENDPOINT", f"where the router listens (default: {LISTEN})"),
        "--root": ("DIR...", "another folder that the scene's files may come from", Path),
        "--must-see": ("SERVICE...", "simulation: a service that acknowledges every frame"),
        "--record": ("FILE", "recorder: where the recording goes", Path),
        "--save": ("FILE.rrd", "viewer: a file for the rerun viewer", Path),
        "--resume": ("FILE", "the recording that the run goes on from; not for viewer and render", Path),
        "--threads": ("N", "most threads for kernels (default: all cores)", int),
        "--named": ("NAME", "what errors call a scene that is no file of the user's"),
    })  # fmt: skip
    parser.set_defaults(threads=0, listen=LISTEN)
    parser.add_argument("--view", choices=["window", "web"], help="viewer: a window, or web on loopback")
    parser.add_argument("--real-time", action="store_true", help="simulation: no frame is sooner than the clock says")
    parser.add_argument("--lifeline", action="store_true", help="end when standard input does: so has the supervisor")
    parser.add_argument("--quiet", action="store_true", help="leave errors that the run hears of to its supervisor")


def serve_command(args: argparse.Namespace) -> int:
    if args.service == "router":
        return _route(args)
    for name in ("scene", "run", "connect"):
        if getattr(args, name) is None:
            what, where = "a scene", f"--run {args.run or 'r1'} --connect {args.connect or LISTEN}"
            remedy = f"for example: nuno serve {args.service} {args.scene or 'skirt-hula'} {where}"
            if args.resume is not None:
                what, file = "the recording's scene", shlex.quote(str(args.resume))
                serve = f"nuno serve {args.service} own.yaml --resume {file} {where}"
                remedy = f"nuno export {file} --scene own.yaml, then {serve}"
            missing = what if name == "scene" else f"--{name}"
            raise BadInput(f"the {args.service} service needs {missing}", remedy=remedy)
    runs.check_id(args.run)
    if args.config is not None:
        from nuno.bus.credentials import role_of, roles

        if (role := role_of(Path(args.config))) in {*roles()} - {args.service}:
            problem, remedy = f"this is the certificate of {role}", f"take that of the service: {args.service}.json5"
            raise BadInput(problem, field="--config", value=args.config, limit=args.service, remedy=remedy)
    stop, keeping = threading.Event(), threading.Event()
    if args.lifeline:
        threading.Thread(target=_hold, args=(args.run, stop, keeping), name="lifeline", daemon=True).start()
    with containment.serving(args.run):
        loaded = scene_file.read(shipped.find(args.scene), args.overrides, args.root, args.named)
        if args.service in ("simulation", "recorder", "dye"):
            # Unlimited, since otherwise slower services would choose another solver.
            loaded = decide(loaded, Budget(NO_END, lambda text: print(text, file=sys.stderr, flush=True)))
    options = Options(args.record, args.save, args.view, args.resume, args.threads, tuple(args.must_see))
    options.real_time = args.real_time
    own = sessions.identity(args.run, args.service)

    def tell(text: str) -> None:
        if not args.quiet:
            print(f"{time.strftime('%H:%M:%S')} {args.run} {args.service}: {text}", file=sys.stderr, flush=True)

    def note(sample: zenoh.Sample) -> None:
        name = str(sample.key_expr).rsplit("/", 1)[-1]
        tell(f"{name} {'is ready' if sample.kind == zenoh.SampleKind.PUT else 'has gone'}")

    tell(f"connects to {args.connect}")
    with sessions.spoke(args.connect, args.config, PATIENCE, own) as session:
        if args.service in KEEPERS:
            keeping.set()
        tell("is connected, and prepares; then it waits for the other services of the run")
        session.liveliness().declare_subscriber(f"nuno/{args.run}/alive/*", note, history=True)
        try:
            if failure := run_service(args.service, loaded, session, args.run, options, stop):
                raise RunFailed(f"the run {'was' if failure in SIGNALS else 'failed:'} {failure}")
        except (BadInput, RunFailed) as error:
            if not args.quiet:
                broken = sessions.cut_off(session, args.connect) if isinstance(error, RunFailed) else ""
                raise (RunFailed(broken) if broken else error) from None
            return 2 if isinstance(error, BadInput) else 1
    tell("the run is over")
    return 0


def _hold(run: str, stop: threading.Event, keeping: threading.Event) -> None:
    """Wait until standard input ends, then end this process: in order, or after a timeout, which is longer if it may
    have a file to close. A plugin that does not come back is named.

    The liveliness of the supervisor is not enough: a service may be compiling or still connecting.
    """
    while os.read(sys.stdin.fileno(), 1024):
        pass
    stop.set()
    time.sleep(FINISH_TIMEOUT if keeping.is_set() else LINGER)
    containment.end_calls(run, LINGER)
    end_process(1)


def _route(args: argparse.Namespace) -> int:
    stop = threading.Event()
    for number in ENDING:
        signal.signal(number, lambda *_: stop.set())
    # Without the name of a run, the router blocks for all sessions.
    services = {sessions.identity(args.run, name): name for name in (SUPERVISOR, *MODULES)} if args.run else {}
    with sessions.hub(args.listen, args.config, list(services) or None) as session:
        print(f"router at {args.listen}", flush=True)
        slow_consumers = SlowConsumers(session, services)
        while not stop.wait(LOOK_SECONDS):
            slow_consumers.look(lambda text: print(text, file=sys.stderr, flush=True))
    return 0


# Certificates and access control for a run on several hosts: nuno certs.

HOSTS = "localhost,127.0.0.1"


def certs_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("folder", type=Path, metavar="DIR", help="where they lie, readable by you only")
    parser.add_argument(
        "--hosts",
        default=HOSTS,
        metavar="A,B",
        help="names and addresses by which hosts reach the router (default: %(default)s)",
    )
    parser.add_argument(
        "--roles", metavar="A,B", help=f"which to make (default: all): {', '.join(credentials.roles())}"
    )
    parser.add_argument("--days", type=int, default=365, metavar="N", help="how long they hold (default: %(default)s)")
    parser.add_argument("--check", action="store_true", help="make none: name what has expired or does not fit")


def certs_command(args: argparse.Namespace) -> int:
    if args.check:
        kept = credentials.check(args.folder)
    else:
        wanted = [role for role in args.roles.split(",") if role] if args.roles else credentials.roles()
        kept = credentials.make(args.folder, tuple(args.hosts.split(",")), wanted, args.days)
    for certificate in kept:
        print(_line(certificate))
    broken = [certificate for certificate in kept if certificate.wrong]
    if not args.check:
        print(f"\ngive each host the file of its role, and no other; {args.folder}/authority.key stays here")
        print(f"for example: nuno serve router --listen tls/0.0.0.0:7447 --config {args.folder}/router.json5")
    return 1 if broken else 0


def _line(kept: Kept) -> str:
    reached = f", reached as {', '.join(kept.hosts)}" if kept.hosts else ""
    state = kept.wrong or f"until {kept.ends:%Y-%m-%d}, {kept.purpose}{reached}"
    return f"{kept.path}  {state}"
