"""Where the points of a sweep are computed, as a command's arguments say: here, in processes, or on a Dask cluster."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from contextlib import closing, contextmanager

from nuno_bench import machine, options
from nuno_bench.sweep.executor import Executor, Processes
from nuno_schemas.errors import BadInput


def add_arguments(parser: argparse.ArgumentParser) -> None:
    options.add_count(parser, "--jobs", "processes on this machine (default: all cores)")
    parser.add_argument(
        "--dask", metavar="ADDRESS", help="a Dask scheduler whose workers compute the points: tcp://HOST:8786"
    )


@contextmanager
def opened(args: argparse.Namespace) -> Iterator[Executor]:
    """The executor that the arguments ask for, all cores where they ask for none.

    Raises BadInput for numbers and combinations that no executor has, and, within seconds, where a cluster cannot be
    reached or has another version of nuno.
    """
    with closing(chosen(args.jobs, args.dask)) as made:
        yield made


def chosen(jobs: int | None, dask: str | None) -> Executor:
    """So many processes, all cores by default, or a cluster at an address. Raises BadInput."""
    if jobs is not None and dask is not None:
        raise BadInput("either --jobs or --dask says where points are computed", value=f"{jobs}, {dask}")
    if dask is not None:
        from nuno_bench.sweep.cluster import Cluster

        return Cluster(dask)
    if jobs is not None and jobs < 1:
        raise BadInput("at least one is needed", field="--jobs", value=jobs)
    number = jobs or machine.cores()
    return Processes(number) if number > 1 else Executor()
