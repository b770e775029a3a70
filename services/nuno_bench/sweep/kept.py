"""What a sweep has finished, on disk line by line while it goes on, so that an interrupted one can be resumed."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from nuno_schemas.errors import BadInput


def require(paths: Sequence[Path]) -> None:
    """Raises BadInput where there is no sweep at all to go on with."""
    if not any(path.is_file() for path in paths):
        raise BadInput("there is no sweep to go on with", field="--resume", value=", ".join(map(str, paths)),
                       remedy="leave --resume out, or name the --out that it was started with")  # fmt: skip


class Kept:
    """JSON objects, one a line, under a first line that says what they belong to.

    lines  what an interrupted sweep had finished: empty unless it is resumed
    """

    def __init__(self, path: Path, identity: Mapping[str, Any], resume: bool) -> None:
        """Start anew, or go on where `resume` and there is a file.

        Raises BadInput where it is another sweep's, and where nothing can be written.
        """
        self.path, head, self.lines = path, dict(identity), list[dict[str, Any]]()
        if resume and path.is_file():
            for line in path.read_text(encoding="utf-8").split("\n"):
                # The last line may be half written; what it held is measured again.
                with suppress(ValueError):
                    self.lines.append(json.loads(line))
            before = self.lines.pop(0) if self.lines else {}
            if other := [name for name, value in head.items() if before.get(name) != value]:
                raise BadInput("what was kept belongs to another sweep", str(path), None, "--resume", ", ".join(other),
                               remedy="leave --resume out, or give another --out")  # fmt: skip
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text("".join(json.dumps(line) + "\n" for line in (head, *self.lines)), encoding="utf-8")
        except OSError as error:
            problem, remedy = f"cannot write there: {error.strerror}", "choose a folder that can be written"
            raise BadInput(problem, field="--out", value=str(path.parent), remedy=remedy) from None

    def add(self, data: Mapping[str, Any]) -> None:
        with self.path.open("a", encoding="utf-8") as stream:
            stream.write(json.dumps(dict(data)) + "\n")
