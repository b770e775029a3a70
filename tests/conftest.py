"""What all tests share: shipped data from outside, and system packages that may be missing."""

from __future__ import annotations

import contextlib
import gc
import importlib
import math
import os
import sys
from collections.abc import Generator, Iterator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import settings

from nuno_kernels.compilation import workers

workers.PATIENCE = math.inf  # pytest's processes have all cores already
gc.set_threshold(1_000_000, 50, 1000)  # between files garbage is collected once: see `_settle`

SHARED = Path(__file__).resolve().parents[1].parent / "shared" / "data"

settings.register_profile("quick", max_examples=60)
settings.register_profile("full", max_examples=400)


def pytest_configure(config: pytest.Config) -> None:
    """Of random examples quick tests try fewer."""
    settings.load_profile("quick" if config.getoption("markexpr") == "not full" else "full")


def pytest_sessionstart(session: pytest.Session) -> None:
    """Where workers run all tests, import their files in another order in each worker.

    Python and pytest compile each file that is new. Workers that go through the files in one order all compile every
    one at the same time; so each compiles its share, and finds what others have compiled.
    """
    worker = getattr(session.config, "workerinput", None)
    if worker is None or session.config.args != session.config.getini("testpaths"):
        return
    paths = sorted(Path(__file__).parent.rglob("test_*.py"))
    first = len(paths) * int(worker["workerid"].removeprefix("gw")) // worker["workercount"]
    sys.path[:0] = sorted({str(path.parent) for path in paths}, reverse=True)
    for path in paths[first:] + paths[:first]:
        with contextlib.suppress(Exception, pytest.skip.Exception):  # said when it is collected
            importlib.import_module(path.stem)


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """A folder with a real body, a real leg and a captured walk; the test skips without it."""
    if not SHARED.is_dir():
        pytest.skip("no shared data beside the project")
    return SHARED


@pytest.fixture(scope="module", autouse=True)
def _settle() -> Iterator[None]:
    """What is left after a file, compiled kernels above all, stays: it is not walked through again for garbage."""
    yield
    gc.collect()
    gc.freeze()


APART = (
    "dye", "knit", "yarn", "stocking", "render", "ray", "curve", "drawing", "field", "sdf", "wrinkle", "xpbd", "shirt",
)  # fmt: skip
"""Words in the names of test files that compile few of the kernels which the others compile."""
DEAREST = "test_cloth_and_bodies"
"""Compiles most of cloth contact, which others need, too: longer than anything else."""


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark cases that are not quick as `full`. Deal files that compile different kernels in turn, the dearest first,
    then those with most tests.

    Workers take files from the head of one queue. Two that compile the same kernel at once both pay for it, while
    one after the other the second finds it in the cache.
    """
    files: dict[Path, list[pytest.Item]] = {}
    for item in items:
        for quick in item.iter_markers("quick"):
            parameters = item.callspec.params  # type: ignore[attr-defined]
            if any(_name_of(parameters[name]) not in values for name, values in quick.kwargs.items()):
                item.add_marker("full")
            if not all(is_quick(parameters) for is_quick in quick.args):
                item.add_marker("full")
        files.setdefault(item.path, []).append(item)
    halves: tuple[list[list[pytest.Item]], list[list[pytest.Item]]] = [], []
    for path, tests in sorted(files.items(), key=lambda entry: (entry[0].stem != DEAREST, -len(entry[1]))):
        halves[any(word in path.stem for word in APART)].append(tests)
    places = [((k + 0.5) / len(half), tests) for half in halves for k, tests in enumerate(half)]
    items[:] = [item for _, tests in sorted(places, key=lambda place: place[0]) for item in tests]


def _name_of(value: Any) -> Any:
    """A plugin's name; of anything else itself."""
    return getattr(value, "name", value)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(
    item: pytest.Item, call: pytest.CallInfo[None]
) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """Where a system package or an extra is missing a test skips by name; in CI, which installs
    them all, it fails. Only outside data, and what a superuser cannot be refused, may be missing.
    """
    report = yield
    excused = ("shared data", "root", "one core", "fewer than")
    if report.skipped and os.environ.get("CI") and not any(word in str(report.longrepr) for word in excused):
        report.outcome = "failed"
        report.longrepr = f"skipped in CI: {report.longrepr}"
    return report
