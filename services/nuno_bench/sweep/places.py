"""Where the points of a sweep are computed, as a command's arguments say: here, in processes, or on a Dask cluster."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from nuno_bench import machine
from nuno_bench.sweep.executor import Executor, Here, Processes
from nuno_schemas.errors import BadInput


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--jobs", type=int, metavar="N", help="processes on this machine (default: all cores)")
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
def opened(args: argparse.Namespace) -> Iterator[Executor]:
    """The executor that the arguments ask for, all cores where they ask for none.

    Raises BadInput, within seconds, where a cluster cannot be reached or has another version of nuno.
    """
    check(args)
    made: Any
    if args.dask is not None:
        from nuno_bench.sweep.cluster import Cluster

        made = Cluster(args.dask)
    elif (number := args.jobs or machine.cores()) > 1:
        made = Processes(number)
    else:
        yield Here()
        return
    try:
        yield made
    finally:
        made.close()
