"""Damaged recordings through every command that reads one: each is right or refused in words, soon, in little memory.

Calls are made in processes of their own, since a recording must not end one either: `python -m soak.damage FOLDER SEED
FIRST NUMBER` makes those of so many recordings and notes each before it begins and after it ends.
"""

from __future__ import annotations

import contextlib
import io
import json
import os
import re
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from random import Random
from typing import Any

from PIL import Image

import nuno
from nuno_bench.report.page import Result
from soak import scenes
from soak.fuzz.forged import TAKEN_AWAY, UNEQUAL, damage
from soak.fuzz.recordings import recorded
from soak.processes import ENVIRONMENT

NUMBER, FEW, EACH = 500, 40, 50
"""Recordings; in a quick look; of one process."""
SLOW, HUNG = 5.0, 60.0
"""Of one call: processor time [s] that it may take, and after how long it is broken off."""
MEMORY = 1024
"""MB that a call may take beyond what the process has taken at its start."""
START = 300.0
"""Longest that a process may take until its first call [s]: it may have to compile kernels."""
CALLS: dict[str, list[str]] = {
    "info": ["info", "FILE"], "info --json": ["info", "FILE", "--json"], "verify": ["verify", "FILE"],
    "replay": ["replay", "FILE", "--fast", "--no-view"],
    "resume": ["run", "--resume", "FILE", "--record", "OUT.mcap", "--no-view", "--set", "duration=LONGER"],
    "export": ["export", "FILE", "--npz", "OUT.npz", "--csv", "OUT.csv", "--scene", "OUT.yaml"],
    "export shapes": ["export", "FILE", "--foxglove", "OUT-f.mcap", "--obj", "OUT-obj"],
    "export pictures": ["export", "FILE", "--png", "OUT.png", "--glb", "OUT.glb", "--gif", "OUT.gif"],
    "export of dye": ["export", "FILE", "--png", "OUT.png", "--rrd", "OUT.rrd"],
    "export forces": ["export", "FILE", "--forces", "OUT-forces.npz"],
}  # fmt: skip
"""What is typed, by its name; FILE is the recording, OUT what is written, and LONGER twice as long as its run."""
RICH: dict[str, Any] = {
    "nuno": 1, "name": "rich", "duration": "0.1 s", "frame_rate": "50 Hz", "record": {"checkpoint_every": "40 ms"},
    "objects": [{"name": "a", "model": scenes.HUNG | {"resolution": [6, 6], "texture": "check.png"}}],
    "bodies": scenes.BALL, "cloth_contact": {"plugin": "offset", "thickness": "2 mm"}, "damping": 0.5,
    "operations": [{"plugin": "wrinkle", "at": "40 ms", **scenes.WRINKLE}],
    "solver": {"plugin": "symplectic_euler", "dt": "auto"}, "until": "rest",
}  # fmt: skip
"""Cloth that has all kinds of memory, is changed while it runs, and takes a file with it."""
ADAPTIVE: dict[str, Any] = RICH | {
    "name": "adaptive", "solver": {"plugin": "dopri5"}, "operations": [], "damping": 1.0, "cloth_contact": None,
}  # fmt: skip
DURATIONS = ("80ms", "4s", "0.2s", "0.2s")
"""Twice those of the runs, in their order."""


class Hung(BaseException):
    """A call took too long; not an Exception, so that nothing takes it for a bad file."""


def run(quick: bool, seed: int) -> list[Result]:
    """A result for each command, and what all have in common."""
    calls, ended = list[dict[str, Any]](), list[str]()
    for first in range(0, FEW if quick else NUMBER, EACH):
        number = min(EACH, (FEW if quick else NUMBER) - first)
        found, why = _run_apart(seed, first, number)
        calls += found
        ended += why
    faults, counts = defaultdict[str, list[str]](list), defaultdict[str, list[int]](lambda: [0, 0, 0])
    for call in calls:
        counts[call["name"]][min(call["code"], 2)] += 1
        if problem := judge(call):
            faults[call["name"]].append(f"{call['recording']} ({call['damage']}): {problem}")
    rows = [
        Result(name, f"wrong, in {counts[name][0]:,} done, {counts[name][1]:,} failed, {counts[name][2]:,} refused", "",
               (len(faults[name]),), bar=0, at_most=True, note="; ".join(faults[name][:9])) for name in CALLS
    ]  # fmt: skip
    return [
        *rows,
        Result("all", "processes ended by a recording", "", (len(ended),), bar=0, at_most=True, note="; ".join(ended)),
        Result("all", "slowest call", "s", (max(call["seconds"] for call in calls),), bar=SLOW, at_most=True),
        Result("all", "most memory taken", "MB", (max(call["mb"] for call in calls),), bar=MEMORY, at_most=True),
    ]


def judge(call: dict[str, Any]) -> str:
    """What is wrong with how a call ended; empty where nothing is."""
    said, code = call["said"], call["code"]
    if call["raised"] or "Traceback" in said:
        return f"{call['raised'] or 'a traceback'}"
    if "\x1b" in said:
        return "a terminal is told what a file says"
    if code not in (0, 1, 2) or (code and not said.strip()):
        return f"code {code}, {said[-200:]!r}"
    if call["name"] == "verify" and code == 0 and call["damage"] in UNEQUAL:
        return f"called equal: {said[-200:]!r}"
    if call["name"] == "info --json" and code == 0 and call["damage"] in TAKEN_AWAY and json.loads(said)["complete"]:
        return "called complete"
    return f"{call['seconds']:.1f} s" if call["seconds"] > SLOW else ""


def _run_apart(seed: int, first: int, number: int) -> tuple[list[dict[str, Any]], list[str]]:
    """The calls of so many recordings, and which of them ended the process; those behind these are made in another."""
    calls, ended = list[dict[str, Any]](), list[str]()
    while number > 0:
        with tempfile.TemporaryDirectory(prefix="nuno-damage-") as name:
            notes = Path(name) / "calls"
            words = [sys.executable, "-m", "soak.damage", name, str(seed), str(first), str(number)]
            patience = START + number * len(CALLS) * HUNG
            with contextlib.suppress(subprocess.TimeoutExpired):
                subprocess.run(words, stdin=subprocess.DEVNULL, capture_output=True, timeout=patience, env=ENVIRONMENT,
                               check=False)  # fmt: skip
            lines = [json.loads(line) for line in notes.read_text().splitlines()] if notes.exists() else []
        calls += [line for line in lines if "code" in line]
        if lines and lines[-1] == {"done": True}:
            break
        last: dict[str, Any] = lines[-1] if lines else {"recording": first, "name": "its start"}
        ended.append(f"{last['recording']} ({last.get('damage')}) at {last['name']}")
        first, number = last["recording"] + 1, first + number - last["recording"] - 1
    return calls, ended


def make_calls(folder: Path, seed: int, first: int, number: int) -> None:
    """Make the calls of so many recordings, and note them."""
    from nuno.cli import main

    signal.signal(signal.SIGALRM, _break_off)
    whole = list(zip(_record_all(folder), DURATIONS, strict=True))
    for i, (data, longer) in enumerate(whole):  # kernels are compiled, and libraries imported, by what is not damaged
        for name in CALLS:
            found = _call(main, folder, f"whole{i}", data, longer, name)
            assert found["code"] == 0 or name.startswith("export "), found
    base = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with (folder / "calls").open("w", buffering=1) as notes:
        for recording in range(first, first + number):
            random = Random(f"{seed} {recording}")
            data, longer = random.choice(whole)
            how, data = damage(data, random)
            for name in CALLS:
                about = {"recording": recording, "damage": how, "name": name}
                notes.write(json.dumps(about) + "\n")
                found = _call(main, folder, str(recording), data, longer, name)
                peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
                notes.write(json.dumps(about | found | {"mb": (peak - base) / 1024}) + "\n")
        notes.write('{"done": true}\n')
    os._exit(0)  # threads of zenoh outlive their session


def _record_all(folder: Path) -> Iterator[bytes]:
    """Recordings that are damaged here: small ones, and two of cloth that takes long to compile."""
    yield from recorded()
    Image.new("RGB", (8, 8)).save(folder / "check.png")
    for scene in (RICH, ADAPTIVE):
        path = folder / f"{scene['name']}.mcap"
        nuno.run({name: value for name, value in scene.items() if value is not None}, record=path, roots=[folder])
        yield path.read_bytes()


def _call(main: Any, folder: Path, recording: str, data: bytes, longer: str, name: str) -> dict[str, Any]:
    """Make one call in a folder of its own; its code, what it said and raised, and the time that it took [s]."""
    place = folder / recording
    place.mkdir()
    (place / "input.mcap").write_bytes(data)
    given = {"FILE": str(place / "input.mcap"), "OUT": str(place / "out"), "LONGER": longer}
    words = [re.sub("FILE|OUT|LONGER", lambda found: given[found[0]], word) for word in CALLS[name]]
    out, raised, code, began = io.StringIO(), "", -1, time.process_time()
    signal.setitimer(signal.ITIMER_REAL, HUNG)
    try:
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(out):
            code = main(words)
    except Exception as error:
        raised = f"{type(error).__name__}: {error}"[:300]
    except Hung:
        raised = f"broken off after {HUNG:g} s"
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        shutil.rmtree(place)
    said = out.getvalue()
    if name == "info --json" and code == 0:
        said = said[said.index("{") :]
    return {"code": code, "said": said[-100_000:], "raised": raised, "seconds": time.process_time() - began}


def _break_off(number: int, frame: object) -> None:
    raise Hung


if __name__ == "__main__":
    make_calls(Path(sys.argv[1]), *map(int, sys.argv[2:5]))
