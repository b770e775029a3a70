"""`nuno studio`: a page for scenes, runs and recordings."""

from __future__ import annotations

import argparse
import threading

from nuno.studio.desk import Desk
from nuno.studio.pages.server import serving


def studio_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--no-browser", action="store_true", help="print the page's address, and open nothing")


def studio_command(args: argparse.Namespace) -> int:
    return serve(Desk(), "studio", "", not args.no_browser)


def serve(desk: Desk, name: str, place: str, opened: bool) -> int:
    """Serve the page, opened at `place`, until Ctrl-C; return the exit code."""
    try:
        with serving(desk.server(), name, opened, place):
            threading.Event().wait()
    except KeyboardInterrupt:
        print("ending", flush=True)
    finally:
        desk.close()
    return 0
