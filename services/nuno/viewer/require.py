"""Requirements of viewing, checked before a run starts."""

from __future__ import annotations

import argparse
import os
import sys
from dataclasses import replace
from pathlib import Path

from nuno.output_files import check_target
from nuno_schemas.errors import BadInput

VIEWS = ("window", "web")
ADDRESS = "rerun+http://"


def has_screen() -> bool:
    """Return whether a window can be opened here."""
    return sys.platform in ("darwin", "win32") or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def add_view(parser: argparse.ArgumentParser, no_view: str) -> None:
    """Add the flags of commands that show a run; `no_view` is the help text of --no-view."""
    view = parser.add_argument_group("viewing").add_mutually_exclusive_group()
    words = "show it in rerun: a window (default where there is a screen) or web on loopback"
    view.add_argument("--view", nargs="?", const="window", choices=VIEWS, help=words)
    view.add_argument("--no-view", action="store_true", help=no_view)
    parser.add_argument("--save", type=Path, metavar="FILE.rrd", help="also write a file for the rerun viewer")


def choose_view(args: argparse.Namespace) -> str | None:
    """Return the view of a run: by default a window, if there is a screen and no other output. Raises BadInput."""
    view: str | None = args.view
    if view is None and not args.no_view and args.save is None and has_screen():
        view = "window"
    require(view, args.save)
    return view


def require(view: str | None, save: Path | None, option: str = "--save") -> None:
    """Raise BadInput if a run could not be shown (`view`) or written (`save`) as requested.

    view  "window", "web", the address of a viewer that is open already, or None
    save  a rerun file to write, or None; `option` is the flag for it
    """
    if view is None and save is None:
        return
    if view is not None and view not in VIEWS and not view.startswith(ADDRESS):
        known = f"known: {', '.join(VIEWS)}, or an open viewer's address such as {ADDRESS}127.0.0.1:9876/proxy"
        raise BadInput("no such view", field="--view", value=view, remedy=known)
    if view == "window" and not has_screen():
        remedy = "--view web serves a page for a browser; --save FILE.rrd writes a file; --no-view shows nothing"
        raise BadInput("there is no screen to open a window on", field="--view", value=view, remedy=remedy)
    if save is not None:
        try:
            check_target(save, ".rrd")
        except BadInput as error:
            raise replace(error, field=option) from None
