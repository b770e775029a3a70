"""Where the points of a sweep are computed: in this process, in several here, or on a Dask cluster.

A task is plain data, and what computes it a function of a module: both can be pickled, and neither
needs a path of this machine. Results are the same bits wherever they come from; only times differ.
"""

from __future__ import annotations

import argparse
import platform
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.metadata import version
from typing import Any, Protocol, TypeVar

from nuno import registry
from nuno_bench import machine
from nuno_schemas.errors import BadInput

Task = TypeVar("Task")
Found = TypeVar("Found")
PACKAGES = ("nuno", "numpy", "numba", "llvmlite")
"""Those on which the bits of a result depend."""


@dataclass(frozen=True)
class Lost:
    """A task whose process was lost as often as it was tried."""

    reason: str


class Executor(Protocol):
    """Computes tasks."""

    where: str
    """In words, for a report."""

    @property
    def width(self) -> int:
        """How many tasks go on at once, now."""

    def run(
        self, call: Callable[[Task], Found], tasks: Iterable[Task]
    ) -> Iterator[tuple[Task, Found | BadInput | Lost]]:
        """Each task with what `call` makes of it, as they are done; a BadInput that it raises is a result.

        Tasks are taken from the iterable only when they can be started. A task whose process is lost is run
        again. Raises RunFailed where no task can be computed any more; what else `call` raises ends the run.
        """


class Here:
    """One task after another, in this process."""

    where = "one after another"
    width = 1

    def run(
        self, call: Callable[[Task], Found], tasks: Iterable[Task]
    ) -> Iterator[tuple[Task, Found | BadInput | Lost]]:
        for task in tasks:
            yield task, attempt(call, task)


def attempt(call: Callable[[Task], Found], task: Task) -> Found | BadInput:
    """What `call` makes of a task, or why the task is refused."""
    try:
        return call(task)
    except BadInput as error:
        return error


def versions() -> dict[str, str]:
    """Versions of everything that a result may depend on, by name; of solvers those of their packages."""
    found = {"Python": ".".join(platform.python_version_tuple()[:2])}
    found |= {name: version(name) for name in PACKAGES}
    for group, kind in (("nuno.integrators", "solver"), ("nuno.dye_solvers", "dye solver")):
        names = sorted(registry.installed(group))
        found |= {f"{kind} {name}": registry.package_version(group, name) for name in names}
    return found


def add_arguments(parser: argparse.ArgumentParser, jobs: str) -> None:
    """`jobs` says what the default is."""
    parser.add_argument("--jobs", type=int, metavar="N", help=f"processes on this machine (default: {jobs})")
    parser.add_argument(
        "--dask", metavar="ADDRESS", help="a Dask scheduler whose workers compute the points: tcp://HOST:8786"
    )


def check(args: argparse.Namespace) -> None:
    """Raises BadInput for numbers and combinations that no executor has."""
    if args.jobs is not None and args.dask is not None:
        raise BadInput("either --jobs or --dask says where points are computed", value=f"{args.jobs}, {args.dask}")
    if args.jobs is not None and args.jobs < 1:
        raise BadInput("at least one process is needed", field="--jobs", value=args.jobs)


@contextmanager
def opened(args: argparse.Namespace, jobs: int = 0) -> Iterator[Executor]:
    """The executor that the arguments ask for; `jobs` (0: all cores) where they ask for none.

    Raises BadInput, within seconds, where a cluster cannot be reached or has another version of nuno.
    """
    check(args)
    made: Any
    if args.dask is not None:
        from nuno_bench.sweep.cluster import Cluster

        made = Cluster(args.dask)
    elif (number := args.jobs or jobs or machine.cores()) > 1:
        from nuno_bench.sweep.local import Processes

        made = Processes(number)
    else:
        yield Here()
        return
    try:
        yield made
    finally:
        made.close()
