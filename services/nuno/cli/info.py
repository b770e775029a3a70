"""`nuno info`: what a recording holds."""

from __future__ import annotations

import argparse
from pathlib import Path

from nuno.recording.reader import open_recording
from nuno.report import lines


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("recording", type=Path, metavar="FILE")


def main(args: argparse.Namespace) -> int:
    with open_recording(args.recording) as recording:
        metadata, span = recording.metadata, recording.span
        end = metadata.get("end", {})
        state = f"{end.get('state', 'unknown')}, {'complete' if recording.complete else 'INCOMPLETE'}"
        if recording.recovered:
            state += "; cut short, read up to the last whole chunk"
        rows = [("file", f"{args.recording} ({args.recording.stat().st_size / 1e6:.1f} MB)"), ("state", state)]
        rows += [(f"{topic}", f"{n} missing") for topic, n in recording.missing.items()]
        rows.append(("time", f"{span[0]:g} to {span[1]:g} s"))
        rows += [(topic, f"{count} messages") for topic, count in recording.counts.items()]
        rows += [("file inside", name) for name in recording.attachments]
        rows.append(("versions", ", ".join(f"{k} {v}" for k, v in metadata.get("versions", {}).items())))
        rows.append(("plugins", ", ".join(metadata.get("plugins", {}))))
        report = recording.report()
        if report:
            rows += [("", ""), *lines(report)]
    for name, text in rows:
        print(f"{name:22} {text}")
    return 0
