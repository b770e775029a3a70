"""Commands on a recording: replay, verify, info, export."""

from __future__ import annotations

import argparse
import contextlib
import json
import re
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any, get_args

import zenoh

from nuno.bus.health import Watch, offer_health
from nuno.bus.messages import Bus
from nuno.bus.sessions import hub_at
from nuno.cli.common import add_config, add_flags, add_set, compilation_notice, warn
from nuno.exports.camera import Side, view_doubts
from nuno.formatting import data_size, many, plain
from nuno.process import scratch, state_of
from nuno.python_api.export import FILES, ExportRequest, Painted, ask, progress_lines, write
from nuno.python_api.progress import ProgressLine
from nuno.recording.reader import (
    END,
    Lacks,
    Recording,
    control_events,
    describe_changes,
    find_lacks,
    open_recording,
    shortcoming,
)
from nuno.replay.publisher import Replay
from nuno.report.run_report import recorded_lines
from nuno.resimulation.verification import Verification, verify
from nuno.runtime import runs
from nuno.runtime.outcome import find_nearest, find_spells, spell_rows
from nuno.runtime.service import SUPERVISOR, Options, run_service
from nuno.scene.recorded_scene import restored_scene
from nuno.viewer.fields import QUANTITIES
from nuno.viewer.live import add_view, choose_view, has_screen, keep_page, require
from nuno_schemas.dyeing import DyeView, Form
from nuno_schemas.errors import BadInput
from nuno_schemas.messages import EVENT, FRAMES, Event, Header

# `nuno export`: meshes, arrays, tables, pictures and animations of a recording.


def export_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("recording", type=Path, metavar="RECORDING", help="a file, or last")
    what = parser.add_argument_group("what to write (any number of these)")
    add_flags(what, {f"--{name}": ("FILE", text, Path) for name, text in FILES.items()})
    _add_yarns(parser.add_argument_group("yarns as curves"))
    _add_parts(parser.add_argument_group("which part"))
    progress_help = "say how far it is, a line each time, not only now and then"
    parser.add_argument("--progress", action="store_true", help=progress_help)
    _add_drawn(parser.add_argument_group("how pictures and animations are drawn (default: as the scene says)"))


def _add_yarns(yarns: argparse._ArgumentGroup) -> None:
    text = "smooth: loops that hook into each other; straight: links, repaired where they would cut through a body "
    yarns.add_argument("--form", choices=get_args(Form), help=f"{text}(default: smooth)")
    add_flags(yarns, {
        "--samples": ("N", "smooth: points a link (default: 8); with --renderer: of a pixel (paths: 64)", int),
        "--radius": ("LENGTH", "of the yarns, e.g. 30um, or of each kind, e.g. 20um,35um (default: 0.04 of the mean "
                     "link, thicker for yarns of a higher linear density)"),
        "--curl": ("SHARE", "smooth: how far loops reach beyond each other, of the shortest link", float),
    })  # fmt: skip


def _add_parts(which: argparse._ArgumentGroup) -> None:
    painted = (
        "pictures, animations and --rrd: cloth in its own texture or colour, by its stretch, or, in pictures, by a "
        "knit's pressure; "
        "--pattern: outlines, the print (cloth), or triangles by their strain, the largest, or along warp or weft "
    )
    default_text = "(default: its own where the scene gives one)"
    which.add_argument("--colour", choices=get_args(Painted), default="auto", help=painted + default_text)
    add_flags(which, {
        "--frame": ("N", "frame for --npz, --forces, --png, --pattern, meshes, yarns (default: last), --usd", int),
        "--start": ("TIME", "animations: from here, e.g. 250ms"),
        "--end": ("TIME", "animations: to here"),
        "--turn": ("TIME", "animations: the camera goes once round --frame, in so long"),
        "--fps": ("N", "animations: pictures a second (default: 25; of dye alone, so that all takes 5 s)", float),
        "--shutter": ("SHARE", "animations: the share of a picture's time in which its shutter is open, e.g. 0.5: "
                      "what moves is blurred", float),
        "--size": ("WxH", "of pictures of moving cloth, e.g. 960x720"),
        "--renderer": ("NAME", "moving cloth by raster (default), or by paths, which follows light through many paths "
                       "(needs nuno[paths])"),
        "--style": ("NAME", "--png of a knit by rays: yarns, lines (straight links), density (of stitches) or map (of "
                    "pressure on skin); --set view.yarns.KEY=VALUE changes how, and view.KEY=VALUE the camera"),
    })  # fmt: skip


def _add_drawn(drawn: argparse._ArgumentGroup) -> None:
    dyed = "dyed cloth: all dye, what fibre has fixed of it, or what is mobile"
    side = "moving cloth: the side of a body that is seen, which faces +z; close: the cloth alone fills the picture"
    drawn.add_argument("--side", choices=get_args(Side), help=side)
    drawn.add_argument("--view", choices=get_args(DyeView), help=dyed)
    add_flags(drawn, {"--scale": ("N", "dyed cloth: pixels a cell", int)})
    sides, part = ("LEFT", "TOP", "RIGHT", "BOTTOM"), "dyed cloth by itself: a part of it, e.g. 2mm 2mm 4mm 3mm"
    drawn.add_argument("--crop", nargs=4, metavar=sides, help=part)
    camera = "change from where moving cloth is looked at, e.g. view.azimuth=90deg (also elevation, target, distance, "
    dye = "size); how dye is drawn, e.g. dye.dyes.0.colour.full=0.1, dye.picture.ground=#f0ead8; with --style how "
    add_set(drawn, camera + dye + "yarns are, e.g. view.yarns.radius=0.1mm")


def export_command(args: argparse.Namespace) -> int:
    with open_recording(runs.find_recording(args.recording)) as recording:
        warn(recording)
        request = ask(**{name: getattr(args, name) for name in ExportRequest.model_fields})
        for text in view_doubts(recording, request.overrides):
            print(f"warning: {text}", file=sys.stderr)
        if request.scene is not None and (changes := describe_changes(control_events(recording))):
            print(f"warning: the scene lacks what was changed during its run: {'; '.join(changes)}", file=sys.stderr)
        drawn = request.png or request.gif or request.mp4
        with compilation_notice() if drawn else contextlib.nullcontext():
            written = write(recording, request, progress_lines(args.progress))
        for path in written:
            print(path)
    return 0


# `nuno info`: what a recording holds, and what it lacks.


def info_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("recording", type=Path, metavar="FILE", help="a recording, or last")
    parser.add_argument("--json", action="store_true", help="the same for a program, as one JSON object")


def info_command(args: argparse.Namespace) -> int:
    with open_recording(runs.find_recording(args.recording)) as recording:
        lacks = find_lacks(recording)
        if args.json:
            print(json.dumps(describe_recording(recording, lacks), indent=2))
            return 0
        rows = _info_rows(recording, lacks)
    for name, text in rows:
        print(plain(f"{name:22} {text}"))
    return 0


def describe_recording(recording: Recording, lacks: Lacks) -> dict[str, Any]:
    """Return the output of `nuno info --json`: file, completeness, counts, missing messages, crossings, report."""
    end, report, size = recording.metadata.get(END, {}), recording.report(), recording.path.stat().st_size
    if isinstance(report.get("frames"), dict):  # unknown when it was written
        report["frames"]["recorded"] = sum(recording.counts.get(topic, 0) for topic in FRAMES)
        report["recorded_bytes"] = size
    return {
        "file": str(recording.path),
        "bytes": size,
        "state": end.get("state", "unknown"),
        "complete": not shortcoming(recording, lacks),
        "cut": recording.recovered and not recording.growing and not recording.damage,
        "damage": recording.damage,
        "growing": recording.growing,
        "messages": recording.counts,
        "missing": lacks.missing,
        "doubled": lacks.doubled,
        "refused": recording.json(end.get("refused", "{}")),
        "span": list(recording.span),
        "attachments": list(recording.attachments),
        "versions": recording.metadata.get("versions", {}),
        "resumed": recording.metadata.get("resumed", {}),
        "plugins": list(recording.metadata.get("plugins", {})),
        "crossings": find_spells(recording),
        "least_distance": find_nearest(recording),
        "report": report,
    }


def _info_rows(recording: Recording, lacks: Lacks) -> list[tuple[str, str]]:
    facts = describe_recording(recording, lacks)
    rows = [("file", f"{facts['file']} ({data_size(facts['bytes'])})")]
    rows.append(("state", f"{facts['state']}, {shortcoming(recording, lacks) or 'complete'}"))
    rows += [(topic, f"{number:,} missing") for topic, number in facts["missing"].items()]
    rows.append(("time", f"{facts['span'][0]:g} to {facts['span'][1]:g} s"))
    rows += [(topic, f"{count} message{'s' if count != 1 else ''}") for topic, count in facts["messages"].items()]
    rows += [("file inside", name) for name in facts["attachments"]]
    rows.append(("versions", ", ".join(f"{name} {version}" for name, version in facts["versions"].items())))
    rows += [("version", f"{name} {version}") for name, version in facts["resumed"].items()]
    packages = recording.metadata.get("plugins", {})
    foreign = {name: f" ({package})" for name, package in packages.items() if package.split()[:1] != ["nuno"]}
    rows.append(("plugins", ", ".join(f"{name}{foreign.get(name, '')}" for name in facts["plugins"])))
    rows += spell_rows(facts["crossings"], facts["least_distance"])
    report = facts["report"]
    return [*rows, *recorded_lines(report), *([("why", str(why))] if (why := report.get("error")) else [])]


# `nuno verify`: simulate a recording again and compare it to the last bit.


def verify_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("recording", type=Path, metavar="FILE", help="a recording, or last")
    parser.add_argument("--threads", type=int, default=0, metavar="N", help="most threads for kernels (default: all)")


def verify_command(args: argparse.Namespace) -> int:
    """Compare; return 1 if the recording differs, or is cut or damaged."""
    with open_recording(runs.find_recording(args.recording)) as recording:
        warn(recording)
        with restored_scene(recording) as loaded:
            scene = loaded.scene
        with ProgressLine(scene) as progress:
            result = verify(recording, args.threads, progress.show)
        complete, cut = recording.complete, recording.recovered and not recording.growing
    if result.frame is None:
        dyed = f" of cloth, {result.dyed} of dye" if result.dyed else ""
        kept = f"{result.published:,} as published, {many(result.kept, 'checkpoint')}"
        print(f"compared: {result.compared + result.dyed:,} digests, {kept}", file=sys.stderr)
        if cut or (complete and str(result.lacks)):  # a run that was stopped has written all that it had
            reason = (
                result.incomplete.removeprefix("INCOMPLETE: ") if cut else f"though its end says so; {result.lacks}"
            )
            print(f"not whole, {reason}; the {result.compared} frames that are there are equal", file=sys.stderr)
            return 1
        print(f"equal to the last bit: {result.compared} frames{dyed}")
        return 0
    print(plain("\n".join(describe_difference(result))), file=sys.stderr)
    return 1


def describe_difference(result: Verification) -> list[str]:
    """Describe the difference in lines."""
    lines = [f"the {result.part} differs first at frame {result.frame} (t = {result.t:g} s)"]
    if (value := result.difference) is None:
        lines.append(
            "  where: not to be said: its digest is another, and what is kept of this frame and later is equal"
        )
    else:
        later = (
            f", seen at frame {value.frame}: of earlier ones too little is kept" if value.frame != result.frame else ""
        )
        kept = "the checkpoint" if value.kept == "checkpoint" else "what was published, which is float32"
        lines += [
            f"  where:    {value.quantity}, {value.index}{later}",
            f"  here:     {value.here!r}",
            f"  recorded: {value.recorded!r}, in {kept}",
            f"  in all:   {value.number:,} of {value.of:,} values differ, by at most {value.farthest:.3g}",
        ]
    if result.others:
        lines.append("equal bits are promised for the same versions and processor only; the recording was made with")
        lines += [f"  {text}" for text in result.others]
    return lines


# `nuno view`: whole recordings in rerun, one, or several in one view.


def view_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("recordings", type=Path, nargs="+", metavar="RECORDING", help="files, or last")
    over = "several: lay them over each other, in a colour each (default: side by side)"
    parser.add_argument("--over", action="store_true", help=over)
    parser.add_argument("--colour", choices=("auto", "cloth", *QUANTITIES), default="auto", help="what is seen first")
    add_view(parser)


def view_command(args: argparse.Namespace) -> int:
    if args.over and len(args.recordings) < 2:
        raise BadInput("one recording alone cannot be laid over another", field="--over", remedy="name two or more")
    view = None if args.save else (args.view or ("window" if has_screen() else "web"))
    require(view, args.save)
    from nuno.viewer import file  # rerun takes as long to import as all of nuno
    from nuno.viewer.comparison import compare, together

    with contextlib.ExitStack() as stack:
        recordings = [stack.enter_context(open_recording(runs.find_recording(path))) for path in args.recordings]
        for recording in recordings:
            warn(recording)
        path = args.save or Path(stack.enter_context(scratch()), "view.rrd")
        if len(recordings) == 1:
            file.convert(recordings[0], path, args.colour, progress_lines())
            subject = file.subject_of(recordings[0])
        else:
            compare(recordings, path, args.over, args.colour, progress_lines())
            subject = together(recordings)
        if view is None:
            print(path)
            return 0
        opened = file.show_file(path, subject, view)
    print(f"the viewer is at {opened.page}" if opened.page else "it is shown in the viewer", flush=True)
    keep_page(view, {"pid": None if opened.reused else opened.pid})
    return 0


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
    replay = Replay(None if args.fast else args.rate, args.start, options.must_see)
    replay.check(recording)
    with contextlib.ExitStack() as stack:
        session, endpoint = stack.enter_context(hub_at(args.listen, args.config))
        stack.enter_context(runs.announced(run, endpoint))
        bus = Bus(session, run, SUPERVISOR)
        offer_health(bus)
        stack.enter_context(bus.alive())
        print(plain(f"replaying {recording.path} as {run} at {endpoint}"), file=sys.stderr)
        answer: dict[str, Any] = {}
        with _viewer(recording, bus, options, args.loop, answer) if shown else contextlib.nullcontext():
            ended = early = _play(replay, bus, recording)
        while args.loop and not ended:  # the viewer has all frames, and plays them again itself
            ended = _play(replay, bus, recording)
        keep_page(view, answer, stays=not ended)
    total = sum(replay.sent.values())
    print(f"{total} messages, {replay.frames} frames")
    if early:
        print(f"{early} before the end of the recording", file=sys.stderr)
    return int(bool(early))


def _play(replay: Replay, bus: Bus, recording: Recording) -> str:
    """Publish a recording once; return the signal that ended it before, or ""."""
    try:
        replay.run(bus, recording)
    except KeyboardInterrupt as signal:
        return state_of(signal)
    return ""


@contextlib.contextmanager
def _viewer(recording: Recording, bus: Bus, options: Options, loop: bool, answer: dict[str, Any]) -> Iterator[None]:
    """The viewer service, in a thread, for one pass of a replay; what it says is printed, and at its end `answer` gets
    the service's last.
    """

    def hear(sample: zenoh.Sample) -> None:
        with contextlib.suppress(ValueError):  # of a malformed message: others refuse it, and count it
            header = Header.model_validate_json(sample.attachment.to_bytes() if sample.attachment else "")
            # A recording may hold what the viewer of its own run said.
            if header.service == "viewer":
                print(plain(Event.model_validate_json(sample.payload.to_bytes()).text), file=sys.stderr, flush=True)

    heard = bus.session.declare_subscriber(bus.key(f"{EVENT.name}/viewer"), hear)
    with heard, restored_scene(recording) as loaded:
        work = ("viewer", loaded, bus.session, bus.run, options)
        thread = threading.Thread(target=run_service, args=work, daemon=True)
        thread.start()
        if Watch(bus).wait_for({"viewer"}, 60.0):
            raise BadInput("the viewer did not start")
        yield
        answer |= bus.ask_json("finish/viewer", {"loop": loop}, 30.0)
        thread.join(10.0)
    if answer.get("file"):
        print(f"rerun file {answer['file']}")
