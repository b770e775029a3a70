"""`nuno verify`: simulate a recording again and compare it to the last bit."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from nuno.api.progress import ProgressLine
from nuno.cli.common import warn
from nuno.formatting import many, plain
from nuno.recording.reader import open_recording
from nuno.replay.verification import Verification, verify
from nuno.runtime import runs
from nuno.scene.recorded_scene import restored_scene


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
    print(plain("\n".join(describe(result))), file=sys.stderr)
    return 1


def describe(result: Verification) -> list[str]:
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
