"""Recordings as calls take them, and what is done with them."""

from __future__ import annotations

import os
import warnings
from collections.abc import Iterable, Iterator, Mapping
from contextlib import AbstractContextManager
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypeAlias, overload

from nuno.api.scene import as_texts
from nuno.api.words import in_python
from nuno.exports import target
from nuno.recording.gaps import shortcoming
from nuno.recording.reader import Recording, open_recording
from nuno.supervision import runs
from nuno_schemas.errors import BadInput

if TYPE_CHECKING:
    from nuno.api.result import Result
    from nuno.frame_state import Acted, FrameState
    from nuno.verification import Verification

    Recorded: TypeAlias = str | os.PathLike[str] | Recording | Result
    """A file, "last", an open recording, or the result of a run."""


def path_of(recording: Recorded) -> Path:
    """Raises BadInput where there is no last one."""
    if isinstance(recording, str | os.PathLike):
        return runs.find_recording(Path(recording))
    if not isinstance(getattr(recording, "path", None), Path):
        limit = 'a file, "last", an open recording, or the result of a run'
        raise BadInput("this is no recording", field="recording", value=recording, limit=limit)
    return recording.path


def opened(recording: Recorded) -> AbstractContextManager[Recording]:
    """It, which is closed again unless it was open before. Raises BadInput."""
    return target.opened(recording if isinstance(recording, Recording) else path_of(recording))


def open_file(recording: str | os.PathLike[str]) -> Recording:
    """A recording's file, or "last", opened: finished or not. Close it, or use it in a `with`. Raises BadInput."""
    with in_python():
        return open_recording(path_of(recording))


@overload
def states(
    recording: Recorded, frames: Iterable[int] | None = None, forces: Literal[False] = False
) -> Iterator[FrameState]: ...


@overload
def states(recording: Recorded, frames: Iterable[int] | None = None, *, forces: Literal[True]) -> Iterator[Acted]: ...


@overload
def states(recording: Recorded, frames: Iterable[int] | None = None, forces: bool = False) -> Iterator[FrameState]: ...


def states(recording: Recorded, frames: Iterable[int] | None = None, forces: bool = False) -> Iterator[FrameState]:
    """Frames of a recording (default: all) as they were, in float64: see nuno.frame_state.states. Raises BadInput."""
    from nuno import frame_state

    with in_python(), opened(recording) as found:
        yield from frame_state.states(found, frames, forces)


def verify(recording: Recorded, threads: int = 0) -> Verification:
    """Simulate a recording again, and compare each frame to the last bit: see `Verification`.

    Warns of a recording that is not complete. Raises BadInput for one without scene or frames.
    """
    from nuno import verification

    with in_python(), opened(recording) as found:
        _warn(found)
        return verification.verify(found, threads)


def _warn(recording: Recording) -> None:
    if why := shortcoming(recording):
        warnings.warn(f"{recording.path}: {why}", stacklevel=3)


def export(recording: Recorded, *overrides: str | Mapping[str, Any], **what: Any) -> list[Path]:
    """Write files of a recording; which, as `nuno export` has it: nuno.export("last", glb="a.glb", frame=30).

    what: fields of nuno.exporting.ExportRequest: a file for each of npz, forces, csv, png, gif, mp4, obj, ply, glb,
    usd, rrd, foxglove, ros2, pattern and yarns that is wanted, and frame, colour, size, view and so on. `overrides` are
    those of --set. Warns of a recording that is not complete. Raises BadInput.
    """
    from nuno.exporting import ask, write

    if isinstance(size := what.get("size"), tuple | list) and len(size) == 2:
        what["size"] = f"{size[0]}x{size[1]}"
    with in_python(), opened(recording) as found:
        _warn(found)
        return write(found, ask(overrides=tuple(as_texts(overrides)), **what))
