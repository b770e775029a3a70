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
    if args.jobs is not None and args.dask is not None:
        raise BadInput("either --jobs or --dask says where points are computed", value=f"{args.jobs}, {args.dask}")
    if args.dask is not None:
        from nuno_bench.sweep.cluster import Cluster

        made: Executor = Cluster(args.dask)
    else:
        number = args.jobs or machine.cores()
        made = Processes(number) if number > 1 else Executor()
    with closing(made):
        yield made
