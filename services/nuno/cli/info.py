"""`nuno info`: what a recording holds, and what it lacks."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

from nuno.formatting import plain
from nuno.recording.gaps import Lacks, find_lacks, shortcoming
from nuno.recording.reader import END, Recording, open_recording
from nuno.report.show import recorded_lines
from nuno.runtime import runs
from nuno.runtime.intersections import find_nearest, find_spells, spell_rows
from nuno_schemas.messages import FRAMES


def info_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("recording", type=Path, metavar="FILE", help="a recording, or last")
    parser.add_argument("--json", action="store_true", help="the same for a program, as one JSON object")


def info_command(args: argparse.Namespace) -> int:
    with open_recording(runs.find_recording(args.recording)) as recording:
        lacks = find_lacks(recording)
        if args.json:
            print(json.dumps(describe(recording, lacks), indent=2))
            return 0
        rows = _rows(recording, lacks)
    for name, text in rows:
        print(plain(f"{name:22} {text}"))
    return 0


def describe(recording: Recording, lacks: Lacks) -> dict[str, Any]:
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
        "plugins": list(recording.metadata.get("plugins", {})),
        "crossings": find_spells(recording),
        "least_distance": find_nearest(recording),
        "report": report,
    }


def _rows(recording: Recording, lacks: Lacks) -> list[tuple[str, str]]:
    facts = describe(recording, lacks)
    rows = [("file", f"{facts['file']} ({facts['bytes'] / 1e6:.1f} MB)")]
    rows.append(("state", f"{facts['state']}, {shortcoming(recording, lacks) or 'complete'}"))
    rows += [(topic, f"{number:,} missing") for topic, number in facts["missing"].items()]
    rows.append(("time", f"{facts['span'][0]:g} to {facts['span'][1]:g} s"))
    rows += [(topic, f"{count} message{'s' if count != 1 else ''}") for topic, count in facts["messages"].items()]
    rows += [("file inside", name) for name in facts["attachments"]]
    rows.append(("versions", ", ".join(f"{name} {version}" for name, version in facts["versions"].items())))
    rows.append(("plugins", ", ".join(facts["plugins"])))
    rows += spell_rows(facts["crossings"], facts["least_distance"])
    report = facts["report"]
    return [*rows, *recorded_lines(report), *([("why", str(why))] if (why := report.get("error")) else [])]
