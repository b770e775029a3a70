"""`python -m nuno` is the `nuno` command."""

from nuno.cli import command

command()
