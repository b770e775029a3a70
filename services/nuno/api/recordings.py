"""Recordings as calls take them, and what is done with them."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

from nuno.api.scene import as_texts
from nuno.api.words import in_python
from nuno.recording.reader import Recording, open_recording
from nuno.supervision import runs
from nuno_schemas.errors import BadInput, nearest

if TYPE_CHECKING:
    from nuno.api.result import Result
    from nuno.verification import Verification

    Recorded: TypeAlias = str | os.PathLike[str] | Recording | Result
    """A file, "last", an open recording, or the result of a run."""


SETTINGS = (
    "colour", "crop", "curl", "end", "form", "fps", "frame", "radius", "samples", "scale", "size", "start", "style",
    "view",
)  # fmt: skip
"""What else `export` takes."""


def path_of(recording: Recorded) -> Path:
    """Raises BadInput where there is no last one."""
    if isinstance(recording, str | os.PathLike):
        return runs.find_recording(Path(recording))
    return recording.path


@contextlib.contextmanager
def opened(recording: Recorded) -> Iterator[Recording]:
    """It, which is closed again unless it was open before. Raises BadInput."""
    if isinstance(recording, Recording):
        yield recording
        return
    with open_recording(path_of(recording)) as found:
        yield found


def verify(recording: Recorded, threads: int = 0) -> Verification:
    """Simulate a recording again, and compare each frame to the last bit: see `Verification`.

    Raises BadInput for a recording without scene or frames.
    """
    from nuno import verification

    with in_python(), opened(recording) as found:
        return verification.verify(found, threads)


def export(recording: Recorded, *overrides: str | Mapping[str, Any], **what: Any) -> list[Path]:
    """Write files of a recording; which, as `nuno export` has it: nuno.export("last", glb="a.glb", frame=30).

    what: a file for each of npz, forces, csv, png, gif, mp4, obj, ply, glb, usd, rrd, pattern and yarns that is wanted,
    and SETTINGS as flags of the same name have them. `overrides` are those of --set. Raises BadInput.
    """
    from nuno.cli import export as command
    from nuno.cli import parser_of

    if unknown := [name for name in what if name not in (*command.FILES, *SETTINGS)]:
        remedy = nearest(unknown[0], [*command.FILES, *SETTINGS])
        raise BadInput("nothing of this name can be exported or set", field=unknown[0], remedy=remedy)
    if not any(what.get(name) for name in command.FILES):
        raise BadInput("no file was asked for", remedy='for example: nuno.export("last", png="last.png")')
    with in_python(), opened(recording) as found:
        words = [word for name, value in what.items() if value is not None for word in _flag(name, value)]
        words += [word for text in as_texts(overrides) for word in ("--set", text)]
        return command.write(found, parser_of("export")[1].parse_args([*words, "--", str(found.path)]))


def _flag(name: str, value: Any) -> list[str]:
    values: Sequence[Any] = value if isinstance(value, list | tuple) else (value,)
    if name == "size" and len(values) == 2:
        values = (f"{values[0]}x{values[1]}",)
    return [f"--{name}", *map(str, values)]
