"""The recordings of a folder: their summaries, and the requests for them."""

from __future__ import annotations

import contextlib
import re
from collections.abc import Mapping
from copy import deepcopy
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from nuno.exports.cloth import cut_pieces
from nuno.exports.tables import scene_files
from nuno.formatting import duration
from nuno.python_api.fit import map_fits, pressing, remarks, tables, verdict
from nuno.recording.reader import END, Recording, open_recording, shortcoming
from nuno.recording.writer import part_of
from nuno.report.run_report import recorded_lines
from nuno.runtime import log, outcome, runs
from nuno.scene.edit import comment
from nuno.scene.files import stamp_of
from nuno.scene.recorded_scene import restored_scene
from nuno.scene.scene_file import Loaded
from nuno.studio.dropped_files import reserve
from nuno.studio.processes import Child
from nuno.studio.scenes import write_whole
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Float
from nuno_schemas.pattern import Altered

PICTURE = ".png"
WHOLE = ".mcap"
PART = part_of(Path(WHOLE)).name
"""Endings of the names of recordings: of finished ones, and of unfinished ones."""


class Recordings:
    """The recordings of a folder, which need not exist yet."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._known: dict[str, tuple[tuple[int, int], dict[str, Any]]] = {}
        self._drawing: dict[str, Child] = {}
        self._verifying: dict[str, Child] = {}

    def list(self) -> list[dict[str, Any]]:
        """Return name, scene, state, simulated time [s], bytes and existence of a picture of each, newest first."""
        entries = []
        for path in (*self.folder.glob(f"*{WHOLE}"), *self.folder.glob(f"*{PART}")):
            with contextlib.suppress(OSError):  # it was removed or finished meanwhile
                stamp = stamp_of(path)
                if self._known.get(path.name, (None,))[0] != stamp:
                    self._known[path.name] = (stamp, _facts(path))
                entries.append((stamp[1], self._known[path.name][1] | {"picture": self.picture_of(path).is_file()}))
        return [facts | {"when": when / 1e9} for when, facts in sorted(entries, key=lambda pair: -pair[0])]

    def find(self, name: object) -> Path:
        """Return the path of a recording. Raises BadInput for any other name."""
        path = self.folder / str(name)
        if not isinstance(name, str) or path.name != name or not name.endswith((WHOLE, PART)) or not path.is_file():
            raise BadInput("no such recording here", value=name, remedy="load the list again")
        return path

    def picture_of(self, path: Path) -> Path:
        """Return the path to which `nuno run` writes the picture of the last frame."""
        return path.with_name(run_of(path.name) + PICTURE)

    def pictures(self) -> dict[str, str]:
        """Return the name of the last recording with a picture of each scene."""
        newest = reversed([facts for facts in self.list() if facts["picture"]])
        return {facts["scene"]: facts["name"] for facts in newest}

    def open(self, name: object) -> dict[str, Any]:
        """Return the rows of a report and of `_ends`, the gaps, and whether it is of dye alone. Raises BadInput."""
        path = self.find(name)
        with open_recording(path) as recording:
            report, lacks = recording.report(), shortcoming(recording)
            rows, dyed, ends = recorded_lines(report), recording.dyed_alone, _ends(report)
        (facts,) = (one for one in self.list() if one["name"] == name)
        return facts | {"rows": rows, "ends": ends, "lacks": lacks or "", "dyed": dyed}

    def draw(self, name: object) -> dict[str, Any]:
        """Draw the last frame in another process; return whether it is still drawing, and its error if it failed."""
        path = self.find(name)
        if self.picture_of(path).is_file():
            return {"drawing": False, "problem": ""}
        child = self._drawing.get(path.name)
        if child is None:
            child = self._drawing[path.name] = Child(["export", str(path), "--png", str(self.picture_of(path))])
        return {"drawing": child.code is None, "problem": (child.said or "it was ended") if child.code else ""}

    def verify(self, name: object) -> dict[str, Any]:
        """Start `nuno verify`, which simulates the recording again and compares. Raises BadInput."""
        path = self.find(name)
        before = self._verifying.get(path.name)
        if before is None or before.code is not None:
            self._verifying[path.name] = Child(["verify", str(path)])
        return self.verdict(name)

    def verdict(self, name: object) -> dict[str, Any]:
        """Return whether the last verification is going on, whether all frames were equal, and its output."""
        child = self._verifying.get(str(name))
        if child is None:
            return {"verifying": False, "equal": None, "words": ""}
        code = child.code
        return {"verifying": code is None, "equal": None if code is None else code == 0, "words": child.said}

    def resumable(self, name: object) -> dict[str, Any]:
        """Return the time from which the run can be resumed, and its scene's end [s]. Raises BadInput if it cannot."""
        with open_recording(self.find(name)) as recording, restored_scene(recording) as loaded:
            return {"at": recording.common_checkpoint().t, "end": loaded.scene.duration}

    def delete(self, name: object) -> dict[str, Any]:
        """Delete a recording with its log and its picture. Raises BadInput."""
        path = self.find(name)
        run = run_of(path.name)
        if run in runs.running():
            raise BadInput("its run goes on", value=path.name, remedy="stop it before")
        for children in (self._drawing, self._verifying):
            if (child := children.pop(path.name, None)) is not None:
                child.end()
        try:
            path.unlink()
            if not any(path.with_name(run + ending).exists() for ending in (WHOLE, PART)):  # they share these files
                for extra in (self.picture_of(path), path.with_name(run + log.SUFFIX)):
                    extra.unlink(missing_ok=True)
        except OSError as error:
            raise BadInput(f"cannot be removed: {error.strerror}", str(path)) from None
        return {}

    def close(self) -> None:
        """End the processes that were started here."""
        for child in (*self._drawing.values(), *self._verifying.values()):
            child.end()


def run_of(name: str) -> str:
    """Return the name of a recording's run."""
    return name.removesuffix(PART).removesuffix(WHOLE)


def measure_fit(path: Path, body: str | None) -> dict[str, Any]:
    """Return the fit of each garment on a body, which may be None if it is the only one, at the last frame, in which it
    is worn and no longer put on: tables, remarks, and maps over its vertices. Raises BadInput.
    """
    with open_recording(path) as recording:
        found, frame = map_fits(recording, body=body), max(number for number, _ in recording.marks().values())
    garments = [
        {
            "name": fit.name, "on": fit.on, "verdict": verdict(fit), "tables": tables(fit),
            "remarks": [*pressing(fit), *remarks(fit)], "start": over.start,
            "pressure": _numbers(over.pressure), "stretch": _numbers(100.0 * over.strain),
        }
        for fit, over in found
    ]  # fmt: skip
    return {"frame": frame, "garments": garments}


# A recording's scene with an edge of a pattern in another length.


def list_edges(path: Path) -> dict[str, Any]:
    """Return the number of the object of each panel, as the page draws them, `Checked.edges` of each object that is
    sewn from a file, and why others have none. Raises BadInput.
    """
    with open_recording(path) as recording, restored_scene(recording) as loaded:
        edges, why = dict[int, Any](), list[str]()
        for k, (part, model) in enumerate(zip(loaded.scene.objects, loaded.models, strict=True)):
            if hasattr(model.plugin, "alter_pattern"):
                edges[k] = model.plugin.check_pattern(loaded.files, model.config.model_dump()["file"], np.inf).edges
            else:
                why.append(
                    f"no edge of {part.name} can be changed: its model, {model.name}, reads no pattern from a file"
                )
        return {"panels": [k for k, _ in _panels(recording, loaded)], "edges": edges, "why": "; ".join(why)}


def _panels(recording: Recording, loaded: Loaded) -> list[tuple[int, str]]:
    """Return the number of the object and the name of each panel, as the page draws them."""
    names = [part.name for part in loaded.scene.objects]
    pieces = [(names.index(piece.name), piece.corners) for piece in cut_pieces(*recording.fabric())]
    return [(k, name) for k, own in pieces if own is not None and own.panels is not None for name in own.panels.names]


def sew_again(path: Path, folder: Path, panel: Any, edge: Any, length: Any) -> tuple[Path, tuple[str, ...]]:
    """Write a recording's scene, and what it lacks of its files, into a folder, and beside the former pattern one with
    an edge of a panel, by its number as the page draws them, `length` [m] long. Return the scene, and the eased seams;
    no file is changed. Raises BadInput.
    """
    with open_recording(path) as recording, restored_scene(recording) as loaded:
        panels, data = _panels(recording, loaded), deepcopy(loaded.data)
        if panel not in range(len(panels)) or not isinstance(edge, int) or not isinstance(length, int | float):
            raise BadInput("this is no edge of a panel, or no length", field="length", value=length)
        number, name = panels[panel]
        model, file = loaded.models[number].plugin, Path(loaded.models[number].config.model_dump()["file"])
        altered: Altered = model.alter_pattern(loaded.files, str(file), (name, edge), length)
        files = scene_files(recording, folder / "scene.yaml")
        try:
            for target in (one for one in files if not one.exists()):
                target.parent.mkdir(parents=True, exist_ok=True)
                target.write_bytes(files[target])
            scene = reserve(folder, f"{_uncounted(loaded.scene.name)}.yaml")
            pattern = reserve(folder / file.parent, f"{_uncounted(file.stem)}{file.suffix}")
            pattern.write_text(altered.text, encoding="utf-8", newline="")
        except OSError as error:
            raise BadInput(f"cannot be written: {error.strerror}", str(folder)) from None
        data["name"], data["objects"][number]["model"]["file"] = scene.stem, str(file.with_name(pattern.name))
        write_whole(scene, comment(replace(loaded, data=data)))
    return scene, altered.eased


def _uncounted(name: str) -> str:
    """Return a name without the number that `reserve` may have given it."""
    return re.sub(r"-\d+$", "", name)


def _numbers(values: Float) -> list[float | None]:
    """Return values with four digits for JSON, None for those that are not finite."""
    return [float(f"{v:.4g}") if np.isfinite(v) else None for v in values.tolist()]


def _ends(report: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Return what a maker asks at the end of a run: whether anything crosses, and how long it took."""
    try:
        facts, wall, prepared = report.get("cloth_contact"), report["wall_seconds"], report["prepare_seconds"]
        crosses = outcome.problem(facts) or (facts and "nothing: cloth passes through neither cloth nor body")
        text = crosses or "not looked for: the scene has no cloth_contact"
        took = f"{duration(wall + prepared)}, of which {duration(prepared)} to get ready"
    except (LookupError, TypeError, ValueError, AttributeError):  # a report from elsewhere
        return []
    return [("Crosses", text), ("Took", f"{took}, for {duration(report['simulated_seconds'])} of cloth")]


def _solver(scene: Mapping[str, Any]) -> str:
    """Return the name of a recorded scene's solver, of moving cloth or of dye."""
    solver = (scene if scene.get("objects") else scene.get("dye") or {}).get("solver")
    return str(solver.get("plugin", "")) if isinstance(solver, dict) else str(solver or "")


def _facts(path: Path) -> dict[str, Any]:
    """Return properties from the file's index, which a file does not have while it is being written. Damage of its
    messages shows when it is opened.
    """
    facts: dict[str, Any] = {
        "name": path.name,
        "scene": "",
        "solver": "",
        "seconds": None,
        "bytes": path.stat().st_size,
    }
    if path.name.endswith(PART):
        return facts | {"state": "not finished"}
    try:
        with Recording(path, scan=False) as recording:
            scene, state = recording.scene, recording.metadata.get(END, {}).get("state", "unknown")
            facts |= {"scene": str(scene.get("name", "")), "solver": _solver(scene), "seconds": recording.span[1]}
            return facts | {"state": "damaged" if recording.damage else state}
    except BadInput as error:
        return facts | {"state": "cannot be read", "problem": str(error)}
