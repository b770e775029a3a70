"""One kind of input in a process of its own: `python -m soak.fuzz.worker KIND FOLDER RUNS SECONDS SEED`.

atheris (libFuzzer for Python) keeps inputs that reach new branches of the readers, and changes those further. What
goes wrong is noted and saved, and the search goes on; the process may end in no other way than by writing its report.
"""

from __future__ import annotations

import contextlib
import inspect
import json
import os
import resource
import signal
import sys
import time
import traceback
import warnings
from collections.abc import Iterable
from pathlib import Path
from random import Random
from types import FunctionType
from typing import Any

from soak.fuzz.kind import Broken, Read

SLOW, HUNG = 2.0, 20.0
"""Of one input, processor time [s]: what counts as a hang, and after how long it is broken off."""
MEMORY = 512 * 2**20
"""What an input may take beyond what was taken at the start [bytes]."""
ADDRESSES = 8 * 2**30
"""Beyond those at the start; an allocation that asks for more fails, and the machine stays usable."""
KEPT = 40
"""Findings that are saved."""
OPTIONS = ("-timeout=1000000", "-mutate_depth=1", "-rss_limit_mb=0", "-malloc_limit_mb=0", "-verbosity=0",
           "-detect_leaks=0", "-len_control=0")  # fmt: skip
"""Of libFuzzer: time and memory are watched here, and what is found does not end the search."""


class Hung(BaseException):
    """An input took too long; not an Exception, so that no reader takes it for a bad file."""


class Trial:
    """Tries inputs, and counts what comes of them."""

    def __init__(self, read: Read, refusals: tuple[type[Exception], ...], folder: Path, hung: float = HUNG) -> None:
        self.read, self.refusals, self.folder, self.hung = read, refusals, folder, hung
        self.inputs = self.accepted = self.crashes = self.hangs = 0
        self.slowest = 0.0
        self.found: dict[str, str] = {}
        """Where it went wrong, and the last line of what was said."""
        self.base = self.peak = _peak()
        self.begin = time.process_time()
        signal.signal(signal.SIGVTALRM, _break_off)

    def one(self, data: bytes) -> None:
        """Read an input; anything but acceptance or refusal is a finding."""
        self.inputs += 1
        start = time.process_time()
        signal.setitimer(signal.ITIMER_VIRTUAL, self.hung)
        try:
            self.read(data)
            self.accepted += 1
        except self.refusals:
            pass
        except Hung as error:
            self._note(error, data)
        except Exception as error:  # whatever a reader may not raise is what is looked for
            self.crashes += 1
            self._note(error, data)
        finally:
            signal.setitimer(signal.ITIMER_VIRTUAL, 0.0)
        seconds = time.process_time() - start
        self.slowest = max(self.slowest, seconds)
        if seconds > SLOW:
            self.hangs += 1
            self._keep(f"{seconds:.1f} s", "slow", data)
        peak = _peak()
        if peak - max(self.base, self.peak) > MEMORY // 8:
            self._keep(f"{(peak - self.base) / 2**20:.0f} MB", "memory", data)
        self.peak = max(self.peak, peak)

    def report(self) -> dict[str, Any]:
        return {
            "inputs": self.inputs, "accepted": self.accepted, "crashes": self.crashes, "hangs": self.hangs,
            "seconds": time.process_time() - self.begin, "slowest": self.slowest,
            "peak_mb": (self.peak - self.base) / 2**20, "found": self.found,
        }  # fmt: skip

    def _note(self, error: BaseException, data: bytes) -> None:
        frames = traceback.extract_tb(error.__traceback__)
        own = [frame for frame in frames if "/nuno" in frame.filename and "/soak/" not in frame.filename] or frames
        if isinstance(error, Broken):
            return self._keep(f"accepted, though not: {error}", str(error), data)
        place = f"{Path(own[-1].filename).name}:{own[-1].lineno}, {Path(frames[-1].filename).name}:{frames[-1].lineno}"
        self._keep(f"{type(error).__name__}: {error}"[:300], place, data)

    def _keep(self, said: str, place: str, data: bytes) -> None:
        if place in self.found or len(self.found) >= KEPT:
            return
        self.found[place] = " ".join(said.split())
        (self.folder / f"found-{len(self.found)}").write_bytes(data)


def _peak() -> int:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024


def _break_off(number: int, frame: object) -> None:
    raise Hung("broken off, since it took too long")


def functions_of(names: Iterable[str]) -> list[FunctionType]:
    """Functions and methods that modules of these names, or below them, define."""
    found: dict[int, FunctionType] = {}
    for module in list(sys.modules.values()):
        own = getattr(module, "__name__", "")
        if any(own == name or own.startswith(f"{name}.") for name in names):
            owners = [module, *(c for c in vars(module).values() if isinstance(c, type) and c.__module__ == own)]
            for value in (value for owner in owners for value in list(vars(owner).values())):
                if isinstance(value, property | staticmethod | classmethod):
                    value = value.fget if isinstance(value, property) else value.__func__
                if isinstance(value, FunctionType) and inspect.unwrap(value).__module__ == own:
                    function = inspect.unwrap(value)
                    found[id(function)] = function
    return list(found.values())


def main(name: str, folder: Path, runs: int, seconds: float, seed: int) -> None:
    """Try `runs` inputs, or as many as `seconds` of processor time allow, guided by the branches they reach.

    Writes `report.json`.
    """
    import atheris

    from soak.fuzz import KINDS

    kind = KINDS[name]
    warnings.simplefilter("ignore")
    seeds = kind.seeds(folder)
    corpus = folder / "corpus"
    corpus.mkdir()
    for number, data in enumerate(seeds):
        (corpus / f"seed-{number}").write_bytes(data)
    read = kind.reader(folder)
    for data in seeds:  # libraries are imported and kernels compiled only now
        with contextlib.suppress(*kind.refusals):
            read(data)
    for function in functions_of(kind.follows):
        atheris.instrument_func(function)
    trial = Trial(read, kind.refusals, folder)

    def one(data: bytes) -> None:
        trial.one(data)
        if trial.inputs >= runs or time.process_time() - trial.begin > seconds:
            (folder / "report.json").write_text(json.dumps(trial.report()))
            os._exit(0)  # libFuzzer would go on

    def mutate(data: bytes, longest: int, number: int) -> bytes:
        random = Random(number)
        # libFuzzer's own changes know what values the readers compare with.
        if random.random() < 0.2:
            return bytes(atheris.Mutate(data, longest))
        # What was changed often is seldom near to anything that is accepted.
        try:
            return kind.mutate(random.choice(seeds) if random.random() < 0.4 else data, random)[:longest]
        except Exception:  # which libFuzzer would end at, and never come to its end
            traceback.print_exc()
            os._exit(1)

    arguments = [sys.argv[0], str(corpus), f"-seed={seed + 1}", f"-max_len={kind.longest}", *OPTIONS]
    atheris.Setup(arguments, one, custom_mutator=mutate)
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    most = pages * resource.getpagesize() + ADDRESSES
    resource.setrlimit(resource.RLIMIT_AS, (most, resource.getrlimit(resource.RLIMIT_AS)[1]))
    atheris.Fuzz()


if __name__ == "__main__":
    main(sys.argv[1], Path(sys.argv[2]), int(sys.argv[3]), float(sys.argv[4]), int(sys.argv[5]))
