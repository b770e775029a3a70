"""The Python API: the same runs as on the command line, from a script or a notebook."""

from __future__ import annotations

import contextlib
import json
import os
import re
import shutil
import tempfile
import warnings
import weakref
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from nuno.choose.cloth import decide
from nuno.recording.reader import Recording, open_recording
from nuno.recording.recorded import per_dye
from nuno.report.make import Report, make_report
from nuno.scene import scene_file, shipped
from nuno.scene.override import as_override
from nuno.scene.scene_file import Loaded
from nuno.service import Options
from nuno.supervision import runs, supervisor
from nuno.supervision.supervisor import Deployment
from nuno_schemas.errors import BadInput, RunFailed
from nuno_schemas.fabric import Float
from nuno_schemas.messages import DYE_CHECKPOINT

GIVEN = "the scene given"
"""What errors call a scene that is a mapping."""
WORDS = (
    (r"--set (\S+)", r'"\1"'),
    (r"--root DIR", "roots=[DIR]"),
    (r"--record FILE", "record=FILE"),
    (r"--set\b", "overrides"),
    (r"--(root)\b", r"\1s"),
    (r"--(record|threads)\b", r"\1"),
)
"""Arguments of the command line, and of `run`."""


class _Folder:
    """A folder that goes with whoever refers to it, at the latest when Python ends."""

    def __init__(self, path: Path) -> None:
        self.path = path
        weakref.finalize(self, shutil.rmtree, path, ignore_errors=True)


@dataclass(frozen=True)
class Result:
    """A finished run.

    x (n, 3) [m] and v (n, 3) [m/s] are the last state, float64; of a cloth that is dyed phi and fixed
    (2, ny, nx), or (dyes, 2, ny, nx) for several dyes, and no vertices where it is dyed alone. digest is
    that of the state, of a dyed garment of its vertices. report is what the command line prints;
    recording is the file with every frame, at `path`. Unless a file was asked for, it is a temporary one: it is
    removed when neither this result nor a `recording` of it is referred to any more.
    """

    state: str
    t: float
    x: Float
    v: Float
    digest: str
    report: Report
    path: Path
    phi: Float | None = None
    fixed: Float | None = None
    folder: _Folder | None = field(default=None, repr=False, compare=False)

    @property
    def recording(self) -> Recording:
        """The recording, opened anew."""
        found = open_recording(self.path)
        found.owner = self.folder
        return found


def run(
    scene: str | os.PathLike[str] | Mapping[str, Any],
    *overrides: str | Mapping[str, Any],
    record: str | os.PathLike[str] | None = None,
    roots: Sequence[str | os.PathLike[str]] = (),
    processes: bool = False,
    threads: int = 0,
    **fields: Any,
) -> Result:
    """Simulate a scene: a file, the name of a shipped scene, or a mapping of its fields.

    `overrides` change it: "key=value" as after --set, or mappings of such keys to values; `fields` are the scene's own
    but `record`, by keyword: nuno.run("hanging-sheet", {"solver.plugin": "rk4"}, duration="2 s"). `record` is the
    recording's file (default: a temporary one, which goes with the result).

    Warns (UserWarning) of what makes the scene or its start doubtful.
    Raises BadInput for a bad scene, RunFailed for a run that failed or diverged, and KeyboardInterrupt for one that a
    signal ended; the recording of both is kept.
    """
    with contextlib.ExitStack() as stack:
        try:
            texts = _as_texts([*overrides, fields])
            loaded = stack.enter_context(_loaded(scene, texts, tuple(Path(root) for root in roots)))
            return _run(decide(loaded), record, processes, threads)
        except BadInput as error:
            raise _in_python(error) from None


def _as_texts(overrides: Sequence[object]) -> list[str]:
    """Overrides as they are written after --set. Raises BadInput for what is neither text nor a mapping, or holds what
    a scene cannot say.
    """
    texts = list[str]()
    for item in overrides:
        if isinstance(item, str):
            texts.append(item)
            continue
        if not isinstance(item, Mapping):
            remedy = 'give each after the scene: nuno.run("hanging-sheet", "duration=1", {"solver.plugin": "rk4"})'
            problem, limit = "an override is neither text nor a mapping", '"key=value", or a mapping of keys to values'
            raise BadInput(problem, "overrides", value=item, limit=limit, remedy=remedy)
        for key, value in item.items():
            try:
                texts.append(as_override(key, value))
            except yaml.YAMLError:
                problem, remedy = "holds what a scene cannot say", "use numbers, text, lists and mappings"
                raise BadInput(problem, "overrides", field=str(key), value=value, remedy=remedy) from None
    return texts


@contextlib.contextmanager
def _loaded(
    scene: str | os.PathLike[str] | Mapping[str, Any], overrides: Sequence[str], roots: tuple[Path, ...]
) -> Iterator[Loaded]:
    """The scene, which services in processes of their own can read meanwhile."""
    if not isinstance(scene, Mapping):
        yield scene_file.read(shipped.find(os.fspath(scene)), overrides, roots)
        return
    try:
        text = json.dumps(dict(scene))
    except (TypeError, ValueError) as error:
        remedy = "use numbers, text, lists and mappings"
        raise BadInput(f"holds what a scene cannot say: {error}", GIVEN, remedy=remedy) from None
    with tempfile.TemporaryDirectory(prefix="nuno-") as folder:
        path = Path(folder) / "scene.yaml"
        path.write_text(text)
        yield scene_file.read(path, overrides, (Path.cwd(), *roots), GIVEN)


def _run(loaded: Loaded, record: str | os.PathLike[str] | None, processes: bool, threads: int) -> Result:
    deployment = Deployment(processes=processes, run=runs.new_id(loaded.scene.name))
    if record is not None:
        return _recorded(loaded, Options(record=Path(record), threads=threads), deployment)
    folder = Path(tempfile.mkdtemp(prefix="nuno-"))
    path = folder / f"{deployment.run}.mcap"
    try:
        options = Options(record=path, threads=threads, temporary=True)
        return replace(_recorded(loaded, options, deployment), folder=_Folder(folder))
    except BaseException:
        if not path.is_file():
            shutil.rmtree(folder, ignore_errors=True)
        raise


def _recorded(loaded: Loaded, options: Options, deployment: Deployment) -> Result:
    path = options.record
    assert path is not None
    outcome = supervisor.supervise(loaded, options, deployment, None, lambda o: make_report(loaded, o))
    report = make_report(loaded, outcome)
    for text in report["warnings"]:
        warnings.warn(text, stacklevel=4)  # at the caller of `run`
    if outcome.error in supervisor.SIGNALS:
        # As whoever calls it would be stopped anywhere else: a loop over scenes is not to go on with the next.
        raise KeyboardInterrupt(f"{outcome.error}; recording kept in {path}")
    if outcome.problem:
        raise RunFailed(f"{outcome.problem}; recording kept in {path}")
    digest = outcome.summary["digest"]
    x = v = np.zeros((0, 3))
    t, amounts = 0.0, dict[str, Float]()
    with open_recording(path) as recording:
        if loaded.scene.moves:
            last = recording.last_checkpoint()
            t, x, v = last.t, np.array(last.x), np.array(last.v)
        if loaded.dye is not None:
            end = recording.last_checkpoint(topic=DYE_CHECKPOINT.name)
            t, amounts = end.t, {name: np.array(per_dye(values)) for name, values in end.state.items()}
    return Result(outcome.state, t, x, v, digest, report, path, amounts.get("phi"), amounts.get("fixed"))


def _in_python(error: BadInput) -> BadInput:
    """The same error in terms of `run`'s own arguments."""
    changed: dict[str, Any] = {}
    for name in ("problem", "file", "field", "limit", "remedy"):
        text = getattr(error, name)
        for flag, argument in WORDS:
            text = re.sub(flag, argument, text) if text is not None else None
        changed[name] = text
    return replace(error, **changed)
