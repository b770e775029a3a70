"""`nuno certs`: certificates and access control for a run on several hosts."""

from __future__ import annotations

import argparse
from pathlib import Path

from nuno.bus import credentials
from nuno.bus.credentials import Kept

HOSTS = "localhost,127.0.0.1"


def certs_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("folder", type=Path, metavar="DIR", help="where they lie, readable by you only")
    parser.add_argument(
        "--hosts",
        default=HOSTS,
        metavar="A,B",
        help="names and addresses by which hosts reach the router (default: %(default)s)",
    )
    parser.add_argument(
        "--roles", metavar="A,B", help=f"which to make (default: all): {', '.join(credentials.roles())}"
    )
    parser.add_argument("--days", type=int, default=365, metavar="N", help="how long they hold (default: %(default)s)")
    parser.add_argument("--check", action="store_true", help="make none: name what has expired or does not fit")


def certs_command(args: argparse.Namespace) -> int:
    if args.check:
        kept = credentials.check(args.folder)
    else:
        wanted = [role for role in args.roles.split(",") if role] if args.roles else credentials.roles()
        kept = credentials.make(args.folder, tuple(args.hosts.split(",")), wanted, args.days)
    for certificate in kept:
        print(_line(certificate))
    broken = [certificate for certificate in kept if certificate.wrong]
    if not args.check:
        print(f"\ngive each host the file of its role, and no other; {args.folder}/authority.key stays here")
        print(f"for example: nuno serve router --listen tls/0.0.0.0:7447 --config {args.folder}/router.json5")
    return 1 if broken else 0


def _line(kept: Kept) -> str:
    reached = f", reached as {', '.join(kept.hosts)}" if kept.hosts else ""
    state = kept.wrong or f"until {kept.ends:%Y-%m-%d}, {kept.purpose}{reached}"
    return f"{kept.path}  {state}"
