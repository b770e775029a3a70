"""Recordings as arguments of calls: opening, reading states, verification, export."""

from __future__ import annotations

import os
import warnings
from collections.abc import Iterable, Iterator, Mapping
from contextlib import AbstractContextManager
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, Protocol, TypeAlias, overload

from nuno.python_api.scene import as_texts, in_python
from nuno.recording import reader
from nuno.recording.reader import Recording, open_recording, shortcoming
from nuno.runtime import runs
from nuno_schemas.errors import BadInput

if TYPE_CHECKING:
    from nuno.resimulation.frame_state import Acted, FrameState
    from nuno.resimulation.verification import Verification


class Finished(Protocol):
    """The result of a run."""

    @property
    def path(self) -> Path: ...
    @property
    def report(self) -> Mapping[str, Any]: ...


Recorded: TypeAlias = str | os.PathLike[str] | Recording | Finished
"""A file, "last", an open recording, or the result of a run."""


def path_of(recording: Recorded) -> Path:
    """Return the path of a recording. Raises BadInput if there is none, or now one of another run."""
    if isinstance(recording, str | os.PathLike):
        return runs.find_recording(Path(recording))
    if not isinstance(getattr(recording, "path", None), Path):
        limit = 'a file, "last", an open recording, or the result of a run'
        raise BadInput("this is no recording", field="recording", value=recording, limit=limit)
    own = recording.metadata["run"] if isinstance(recording, Recording) else {"id": recording.report["run"]}
    with Recording(recording.path, scan=False) as now:
        if (run := now.metadata["run"].get("id")) != own.get("id"):
            problem, remedy = "the file was replaced by that of another run", "record each run in a file of its own"
            raise BadInput(problem, str(recording.path), value=run, limit=f"run {own.get('id')}", remedy=remedy)
    return recording.path


def opened(recording: Recorded) -> AbstractContextManager[Recording]:
    """Open a recording; it is closed again unless it was open before. Raises BadInput."""
    return reader.opened(recording if isinstance(recording, Recording) else path_of(recording))


def open_file(recording: str | os.PathLike[str]) -> Recording:
    """Open a recording's file, or "last", complete or not. Close it, or use it in a `with`. Raises BadInput."""
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
    """Yield frames of a recording (default: all) in float64, each once, in the order of time. Raises BadInput."""
    from nuno.resimulation import frame_state

    with in_python(), opened(recording) as source:
        yield from frame_state.states(source, frames, forces)


def verify(recording: Recorded, threads: int = 0) -> Verification:
    """Simulate a recording again, and compare the bits of each frame; return a `Verification`.

    Warns of a recording that is not complete. Raises BadInput for one without scene or frames.
    """
    from nuno.resimulation import verification

    with in_python(), opened(recording) as source:
        _warn(source)
        return verification.verify(source, threads)


def _warn(recording: Recording) -> None:
    if why := shortcoming(recording):
        warnings.warn(f"{recording.path}: {why}", stacklevel=3)


def export(recording: Recorded, *overrides: str | Mapping[str, Any], **what: Any) -> list[Path]:
    """Write files of a recording, with the options of `nuno export`: nuno.export("last", glb="a.glb", frame=30).

    what: fields of nuno.python_api.export.ExportRequest: a file for each wanted one of npz, forces, csv, png, gif, mp4,
    obj, ply, glb, usd, rrd, foxglove, ros2, pattern and yarns, and frame, colour, size, view and so on. `overrides` are
    those of --set. Warns of a recording that is not complete. Raises BadInput.
    """
    from nuno.exports.camera import view_doubts
    from nuno.python_api.export import ask, write

    if isinstance(size := what.get("size"), tuple | list) and len(size) == 2:
        what["size"] = f"{size[0]}x{size[1]}"
    with in_python(), opened(recording) as source:
        _warn(source)
        asked = ask(overrides=tuple(as_texts(overrides)), **what)
        for text in view_doubts(source, asked.overrides):
            warnings.warn(text, stacklevel=2)
        return write(source, asked)
