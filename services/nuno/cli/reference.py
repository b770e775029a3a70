"""Reference of all commands with their arguments, from their parsers: docs/reference/commands.md."""

from __future__ import annotations

import argparse
from collections.abc import Iterator

from nuno import cli
from nuno.cli.reference_tables.fields import plain, table

INTRODUCTION = """\
# Commands

<!-- made by: nuno schema --commands -->

`nuno COMMAND --help` says the same. Exit codes: 0 done, 1 failed, diverged or ended by a signal, 2 bad input.
"""


def describe_commands() -> str:
    """Return the page; imports every command."""
    parts = [INTRODUCTION]
    for name in cli.COMMANDS:
        module, parser = cli.parser_of(name)
        parts += _command(f"nuno {name}", parser, "##")
        # Commands with subcommands that have their own arguments: `nuno bench`.
        for kind in getattr(module, "COMMANDS", ()):
            parts += _command(f"nuno {name} {kind}", module.parser_of(kind)[1], "###")
    return "\n".join(parts) + "\n"


def _command(name: str, parser: argparse.ArgumentParser, level: str) -> Iterator[str]:
    yield f"\n{level} {name}\n\n{plain(parser.description)}\n"
    rows = [row for action in parser._actions if (row := _row(action, parser._get_formatter()))]
    yield table(["argument", "default", "meaning"], rows) if rows else "No arguments."


def _row(action: argparse.Action, formatter: argparse.HelpFormatter) -> list[str] | None:
    """Return an argument, its default and its meaning; None for --help and hidden ones."""
    if isinstance(action, argparse._HelpAction) or action.help == argparse.SUPPRESS:
        return None
    values = "" if action.nargs == 0 else _values(action)
    written = ", ".join(action.option_strings)
    text = formatter._expand_help(action) if action.help else ""
    shown = action.default not in (None, False, [], (), argparse.SUPPRESS) and "default" not in text
    return [f"`{' '.join(filter(None, [written, values]))}`", f"`{action.default}`" if shown else "", plain(text)]


def _values(action: argparse.Action) -> str:
    if action.choices is not None and action.metavar is None:
        value = "{" + ",".join(map(str, action.choices)) + "}"
    else:
        name = action.metavar or (action.dest.upper() if action.option_strings else action.dest)
        value = name if isinstance(name, str) else " ".join(name)
    many = {"?": f"[{value}]", "*": f"[{value} ...]", "+": f"{value} ...", argparse.REMAINDER: "..."}
    return many.get(str(action.nargs), value) if action.nargs else value
