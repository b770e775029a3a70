"""`nuno weave`: what a weaver's draft holds, and the draft drawn in its colours and at its scale."""

from __future__ import annotations

import argparse
from pathlib import Path

from nuno.exports.dyed_pictures import caption
from nuno.output_files import check_target, write_png
from nuno.plugin_contract import registry
from nuno_schemas.errors import BadInput
from nuno_schemas.pictures import DrawnDraft


def weave_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("draft", type=Path, metavar="FILE", help="a Weaving Information File, .wif")
    parser.add_argument(
        "--png", type=Path, metavar="FILE", help="draw it: threading, tie-up, treadling and drawdown, with a scale"
    )


def weave_command(args: argparse.Namespace) -> int:
    if not args.draft.is_file():
        raise BadInput("no such file", value=str(args.draft), remedy="a WIF file that a weaving program has written")
    if args.png is not None:
        check_target(args.png, ".png")
    cloth = registry.offering("nuno.dye_cloths", "draw_draft", "draws drafts")
    drawn: DrawnDraft = cloth.draw_draft(args.draft)
    width = max(map(len, drawn.facts))
    print(f"{args.draft.name}\n" + "\n".join(f"  {name:{width}}  {text}" for name, text in drawn.facts.items()))
    if args.png is not None:
        words = f"{drawn.facts['ends']} ends x {drawn.facts['picks']} picks"
        words += f"   {drawn.facts['size']}" if drawn.pixel is not None else ""
        print(write_png(args.png, caption(drawn.picture, words, drawn.pixel)))
    return 0
