"""The `nuno` command. Exit codes: 0 done, 1 failed, diverged or ended by a signal, 2 bad input."""

from __future__ import annotations

import argparse
import errno
import importlib
import os
import sys
import traceback
from collections.abc import Mapping, Sequence
from types import ModuleType
from typing import Any, NoReturn

from nuno import process
from nuno.formatting import plain
from nuno_schemas.errors import BadInput, RunFailed, nearest

COMMANDS = {
    "run": ("nuno.cli.run", "simulate a scene, record it, show it, report on it"),
    "new": ("nuno.cli.run", "a commented scene to start from: skirt, poncho, trousers, dye and more"),
    "plan": ("nuno.cli.run", "what a scene will run, what is left out, cost and stable step"),
    "view": ("nuno.cli.recordings", "look at a recording, or compare several in one view"),
    "replay": ("nuno.cli.recordings", "publish a recording again, and show it"),
    "verify": ("nuno.cli.recordings", "simulate a recording again and compare every frame to the last bit"),
    "info": ("nuno.cli.recordings", "what a recording holds"),
    "export": ("nuno.cli.recordings", "meshes, arrays, tables, pictures and animations of a recording"),
    "control": ("nuno.cli.active_runs", "pause, resume, step, stop, change or add to a run that goes on"),
    "top": (
        "nuno.cli.active_runs",
        "what services of a run that goes on are doing: rates, who is behind, what was lost",
    ),
    "topics": ("nuno.cli.active_runs", "what a run that goes on publishes on its bus: topics, types, sizes, rates"),
    "draw": ("nuno.cli.studio", "a page for drawing ridges and valleys on a cloth by hand"),
    "studio": ("nuno.cli.studio", "a page for scenes, runs and recordings, in the browser"),
    "serve": ("nuno.cli.serve", "one service, to run services by hand or in containers"),
    "certs": ("nuno.cli.serve", "certificates and access control, for a run on several hosts"),
    "bench": (
        "nuno_bench.cli",
        "measurements: speed, integrators, precision, accuracy, compare, stability, peers",
    ),
    "sweep": ("nuno_bench.sweep.grid", "a scene run for each combination of values of its fields, in one table"),
    "validate": ("nuno_bench.validation.command", "the laws of physics, held against every installed solver"),
    "gallery": (
        "nuno_bench.gallery.command",
        "one page with pictures of all scenes of a kind: contact, dye, knit, sewn, skirt, wrinkle; or papers",
    ),
    "plugins": ("nuno.cli.installation", "which plugins are installed"),
    "scenes": ("nuno.cli.installation", "the scenes that come with nuno"),
    "fabrics": (
        "nuno_bench.fabric_tests.swatches",
        "the fabrics that scenes can name, in measured units; sources",
    ),
    "fabric": ("nuno.cli.textiles", "a fabric from a laboratory's sheet: KES-F, FAST or a cantilever"),
    "sew": ("nuno.cli.sew", "a garment from its sewing pattern, put on a body; or what is wrong with the pattern"),
    "fit": ("nuno.cli.fit", "how a garment fits the body that wears it: girths, ease, strain, pressure"),
    "test": ("nuno_bench.fabric_tests.sheet", "a fabric on virtual instruments: KES, ASTM D1388, Cusick's drapemeter"),
    "yarns": ("nuno.cli.textiles", "the yarns that knits can name, with sources"),
    "dyes": ("nuno.cli.textiles", "the dyes that scenes can name, with sources"),
    "weave": (
        "nuno.cli.textiles",
        "a weaver's draft, a WIF file: what it holds, drawn in colours and at its scale",
    ),
    "blender-addon": ("nuno.cli.installation", "an add-on for Blender: a shot goes out, and its garment comes back"),
    "schema": ("nuno.cli.installation", "JSON Schema of scenes, for editors"),
    "doctor": ("nuno.cli.doctor", "whether this machine has what nuno can use"),
}
"""Module and summary of each command; a module has `NAME_arguments(parser)` and `NAME_command(args)` for it.
It is imported only when its command is given, so that `nuno run` does not pay for the rest."""


class _Once(argparse._StoreAction):
    """Stores the value of an option, which a second one does not replace."""

    seen: argparse.Namespace | None = None

    def __call__(
        self, parser: argparse.ArgumentParser, namespace: argparse.Namespace, values: Any, option: str | None = None
    ) -> None:
        """Store a value, as argparse."""
        if option is not None and self.seen is namespace:
            raise argparse.ArgumentError(self, "takes one value, and is given more than once")
        self.seen = namespace
        super().__call__(parser, namespace, values, option)


class Parser(argparse.ArgumentParser):
    """A parser of arguments whose errors are BadInput."""

    def __init__(self, **settings: Any) -> None:
        super().__init__(**settings)
        self.register("action", None, _Once)

    def error(self, message: str) -> NoReturn:
        raise BadInput(message, remedy=f"{self.prog} --help")


def command() -> NoReturn:
    """Run the console script: a command, then `leave` with its exit code."""
    process.open_streams()
    process.return_large_arrays()
    process.import_no_own_files()
    process.end_when_terminated()
    process.fail_on_exit()
    process.refuse_exit()
    code = 1
    try:
        code = main()
    except SystemExit as end:  # of --help
        code = end.code if isinstance(end.code, int) else int(end.code is not None)
    except Exception:  # a fault of ours
        traceback.print_exc()
    finally:
        # Python's own way out would call `fail_on_exit` when Python is no more.
        process.leave(code)


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command; returns the exit code."""
    arguments = list(sys.argv[1:] if argv is None else argv)
    try:
        return _dispatch(arguments)
    except BadInput as error:
        print(plain(f"error: {error}"), file=sys.stderr)
        return 2
    except RunFailed as error:
        print(plain(f"failed: {error}"), file=sys.stderr)
        return 1
    except KeyboardInterrupt as error:
        if "--lifeline" not in arguments:  # else its supervisor says so
            print(process.state_of(error), file=sys.stderr)
        return 1
    except BrokenPipeError:
        sys.stdout = open(os.devnull, "w")  # noqa: SIM115
        return 1
    except OSError as error:
        if error.filename is not None and error.errno in (errno.ENAMETOOLONG, errno.EACCES):
            problem, remedy = f"cannot be reached: {error.strerror}", "choose another name or place"
            print(f"error: {BadInput(problem, value=error.filename, remedy=remedy)}", file=sys.stderr)
            return 2
        if getattr(sys.stdout, "fault", ""):
            return 1  # which is said at the end
        if error.errno not in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS):
            raise
        problem = f"cannot be written: {error.strerror}"
        remedy = "make room, there and for temporary files (TMPDIR), or choose another place"
        print(f"error: {BadInput(problem, value=error.filename, remedy=remedy)}", file=sys.stderr)
        return 2


def _dispatch(arguments: list[str]) -> int:
    if not arguments or arguments[0] in ("-h", "--help", "help"):
        print(_help())
        return 0
    if arguments[0] == "--version":
        from importlib.metadata import version

        print(f"nuno {version('nuno')}")
        return 0
    for text in (*arguments, process.working_folder()):
        try:
            text.encode()
        except UnicodeEncodeError:
            problem = "a name is not UTF-8, which recordings and messages are written in"
            raise BadInput(problem, value=text, remedy="rename the file or folder") from None
    module, parser = parser_of(arguments[0])
    return int(getattr(module, f"{arguments[0].replace('-', '_')}_command")(parser.parse_args(arguments[1:])))


def parser_of(
    name: str, commands: Mapping[str, tuple[str, str]] = COMMANDS, program: str = "nuno"
) -> tuple[ModuleType, argparse.ArgumentParser]:
    """Return a command's module, and the parser of its arguments. Raises BadInput for an unknown name."""
    if name not in commands:
        raise BadInput(f"no command {name!r}", remedy=nearest(name, commands))
    path, summary = commands[name]
    module = importlib.import_module(path)
    parser = Parser(
        prog=f"{program} {name}",
        description=summary[0].upper() + summary[1:] + ".",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.set_defaults(command=name)
    getattr(module, f"{name.replace('-', '_')}_arguments")(parser)
    return module, parser


def _help() -> str:
    width = max(map(len, COMMANDS))
    rows = [f"  {name:{width}}  {summary}" for name, (_, summary) in COMMANDS.items()]
    return (
        "nuno: textile simulation as services\n\nusage: nuno COMMAND ...\n\n"
        + "\n".join(rows)
        + "\n\n`nuno COMMAND --help` says more; start with `nuno run skirt-hula`."
    )
