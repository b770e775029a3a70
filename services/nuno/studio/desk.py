"""The requests of a page of the studio."""

from __future__ import annotations

import contextlib
import functools
import json
import re
import shutil
import tempfile
import threading
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from nuno.plugin_contract import registry
from nuno.runtime import runs
from nuno.scene import edit, scene_file, yaml_lines
from nuno.scene.files import MARK, read_scene, stamp_of
from nuno.scene.recorded_scene import resumed_scene
from nuno.scene.scene_file import Loaded
from nuno.studio import dye, scenes
from nuno.studio.cloth import Starts
from nuno.studio.dropped_files import MOST
from nuno.studio.dye import Dyed, cloth_of
from nuno.studio.files import Files
from nuno.studio.lines import Drawing
from nuno.studio.processes import Child, Workshop
from nuno.studio.recordings import Recordings, list_edges, measure_fit, run_of, sew_again
from nuno.studio.run import Run
from nuno.studio.screen import Screen
from nuno.studio.server import NOT_FOUND, Act, Refused, Server, Take
from nuno_schemas.dyeing import PRESETS, DyeColour
from nuno_schemas.errors import BadInput, nearest
from nuno_schemas.preset import Preset

# Exported files of a recording: made by `nuno export` in another process, and sent to the browser.

KINDS = {
    "png": (".png", "image/png"), "mp4": (".mp4", "video/mp4"), "glb": (".glb", "model/gltf-binary"),
    "csv": (".csv", "text/csv"), "scene": (".yaml", "application/yaml"),
}  # fmt: skip
"""Ending and media type of the file, by the flag of `nuno export`."""
FAR = re.compile(r"^(\d+) of (\d+)$", re.MULTILINE)


class Exports:
    """Exported files of recordings, kept until the page is closed."""

    def __init__(self, recordings: Recordings) -> None:
        self._recordings = recordings
        self._folder = tempfile.TemporaryDirectory(prefix="nuno-")
        self._made: dict[tuple[str, str], tuple[tuple[tuple[int, int], list[str]], Child]] = {}

    @property
    def folder(self) -> Path:
        """Folder of the files, readable by this user alone."""
        return Path(self._folder.name)

    def export(self, request: Mapping[str, Any]) -> dict[str, Any]:
        """Start the export of a file, unless it is done or going on; return its progress from 0 to 1, its name and
        bytes, or its error. Raises BadInput.
        """
        path, kind = self._recordings.find(request.get("recording")), str(request.get("kind"))
        flags = _flags(request) if kind in ("png", "mp4") else []
        if kind not in KINDS:
            raise BadInput("no such file can be made", value=kind, remedy=nearest(kind, KINDS))
        stamp = stamp_of(path), flags
        before = self._made.get((path.name, kind))
        going = before is not None and before[1].code is None  # the file may have grown since its start
        if before is not None and going and before[0][1] != flags:
            before[1].end()
            going = False
        if before is None or (not going and (before[0] != stamp or (before[1].code and request.get("again")))):
            shutil.rmtree(self._file(path.name, kind).parent)  # a scene's files of an earlier recording of this name
            child = Child(["export", str(path), f"--{kind}", str(self._file(path.name, kind)), "--progress", *flags])
            before = self._made[path.name, kind] = (stamp, child)
        child = before[1]
        code, steps = child.code, FAR.findall(child.said)
        share = int(steps[-1][0]) / max(1, int(steps[-1][1])) if steps else None
        file = self._file(path.name, kind)
        return {
            "making": code is None, "share": share, "name": file.name,
            "bytes": file.stat().st_size if code == 0 else None,
            "problem": FAR.sub("", child.said).strip().removeprefix(f"error: {path}: ") if code else "",
        }  # fmt: skip

    def file(self, query: Mapping[str, list[str]]) -> tuple[str, bytes]:
        """Return the type and bytes of an exported file. Raises Refused."""
        name, kind = (query.get(key, [""])[0] for key in ("recording", "kind"))
        made = self._made.get((name, kind))
        if made is None or made[1].code != 0:
            raise Refused(NOT_FOUND, "there is no such file")
        return KINDS[kind][1], self._file(name, kind).read_bytes()

    def _file(self, recording: str, kind: str) -> Path:
        folder = self.folder / recording / kind
        folder.mkdir(parents=True, exist_ok=True)
        return folder / f"{run_of(recording)}{KINDS[kind][0]}"

    def forget(self, name: str) -> None:
        """Stop the exports of a recording, and remove its files."""
        for key in [key for key in self._made if key[0] == name]:
            self._made.pop(key)[1].end()
            shutil.rmtree(self._file(*key).parent)

    def close(self) -> None:
        """Stop all exports, and remove all files."""
        for _, child in self._made.values():
            child.end()
        self._folder.cleanup()


def _flags(request: Mapping[str, Any]) -> list[str]:
    """Return the flags of `nuno export` for a requested frame, size and camera, each of which may be omitted."""
    flags = [f"--{name}={request[name]}" for name in ("frame", "size") if name in request]
    camera = request.get("camera")
    for name, value in camera.items() if isinstance(camera, dict) else ():
        flags.append(f"--set=view.{name}={json.dumps(value)}")
    return flags


# Swatches of presets: a dye's colours, a fabric's weight and bending rigidity.

SHADES = ("light", "mid", "dark")


def swatches() -> dict[str, Any]:
    """Return the colours of each dye from light to dark, and the areal density [g/m^2] and bending rigidity, the mean
    of warp and weft [uN m], of each fabric.
    """
    model = registry.offering("nuno.models", "presets", "lists fabrics")
    return {
        "dyes": {name: _shades(preset.fields.get("colour", {})) for name, preset in PRESETS.items()},
        "fabrics": {preset.name: _feel(preset) for preset in model.presets()},
    }


def _shades(fields: dict[str, str]) -> list[str]:
    colour = DyeColour.model_validate(fields)
    return [str(getattr(colour, shade)) for shade in SHADES]


def _feel(preset: Preset) -> dict[str, float]:
    values = {measure.name: measure.given for measure in preset.measures}
    bends = [value for name in ("bend_warp", "bend_weft") if (value := values.get(name)) is not None]
    return {"density": values["density"] or 0.0, "bend": sum(bends) / len(bends)}


LOOKS, PLANS = (60.0, 3 * 2**30), 900.0
"""Limits of building cloth for a page [s, bytes], and of planning [s]: the first time compiles kernels."""
CONTROLS = ("pause", "resume", "step", "stop", "set", "add")
"""Actions of a run that a page may request, as `nuno control`."""


class Desk:
    """Answers the requests of the studio's page, for the folder in which it was started."""

    def __init__(self) -> None:
        self.scenes, self.recordings = scenes.Scenes(Path()), Recordings(runs.RECORDINGS)
        self.screen = Screen(self.recordings)
        self._own: Run | None = None
        # Planning compiles kernels; a preview must be quick, and a run reports its own cost.
        remedy = "run it, or make its triangles or cells larger"
        self._previews = Workshop("building the cloth for a look", LOOKS[0], remedy, LOOKS[1])
        self._plans = Workshop("planning", PLANS, "run it; its first frame is what takes long")
        self._measures = Workshop("measuring the fit", PLANS, "nuno fit has no such limit")
        self._measuring = threading.Lock()
        self._measure = functools.lru_cache(8)(
            lambda path, stamp, body: self._measures.make(path.name, measure_fit, path, body)
        )
        self._starts, self._dyed_cloth = Starts(self._previews), Dyed(self._previews)
        self._drawing = Drawing(self._starts)
        self._starting = threading.Lock()
        self._schema, self._looks = functools.cache(scenes.schema), functools.cache(swatches)
        self.files, self.exports = Files(Path(), runs.RECORDINGS), Exports(self.recordings)
        recordings, screen, files = self.recordings, self.screen, self.files
        self._acts: dict[str, Act] = {
            "scenes": self._scenes, "open": self._open, "check": self._check, "change": self._change,
            "save": self._save, "plan": self._plan, "leave": self._leave, "see": self._see, "dyed": self._dyed,
            "paint": self._paint, "draw": self._draw, "swatches": lambda _: self._looks(),
            "run": self._run, "resume": self._resume, "control": self._control, "sew": self._sew,
            "now": lambda _: self._own.tell() if self._own is not None else {"state": "none"},
            "recordings": lambda _: {"recordings": recordings.list()}, "recording": _of_one(recordings.open),
            "picture": _of_one(recordings.draw), "delete": _of_one(self._delete), "fit": self._fit,
            "verify": _of_one(recordings.verify), "verdict": _of_one(recordings.verdict),
            "resumable": _of_one(recordings.resumable), "edges": _of_one(lambda of: list_edges(recordings.find(of))),
            "replay": screen.replay, "plots": screen.plots, "compare": screen.compare, "export": self.exports.export,
            "files": files.files, "expect": files.expect, "about": files.about, "make": files.make,
            "drawdown": files.drawdown, "save_draft": files.save_draft,
        }  # fmt: skip

    def attach(self, run: str, entry: str, config: str | None = None) -> None:
        """Show a run that was started elsewhere, of the scene with the page's name `entry`."""
        self._own = Run.attach(run, entry, config)

    def server(self) -> Server:
        """Return the server of the page, which runs until it is closed."""
        resources = {
            "schema": lambda _: ("application/json", self._schema()),
            "picture": self._picture,
            "drawn": self._scene_picture,
            "shown": self.files.picture,
            "exported": self.exports.file,
            "start": self._starts.tell,
            "live": self._live,
            "flat": self._dyed_cloth.tell,
            "frames": self.screen.frames,
            "shape": self.screen.shape,
            "dyed": self.screen.dyed,
        }
        threading.Thread(target=self._begin_building, daemon=True).start()
        return Server(self.act, resources, Take(self.files.take, MOST))

    def _begin_building(self) -> None:
        """Start the process that builds cloth, which takes seconds, before a scene is opened."""
        with contextlib.suppress(BadInput):
            scene = "hanging-sheet"
            self._see({"scene": scene, "text": read_scene(self.scenes.find(scene)), "page": "first"})

    def act(self, request: Mapping[str, Any]) -> dict[str, Any]:
        """Carry out one request of the page and return its answer. Raises BadInput, which the page shows."""
        name = str(request.get("do"))
        if name not in self._acts:
            raise BadInput("no such request", value=name, limit=", ".join(self._acts))
        return self._acts[name](request)

    def close(self) -> None:
        """End the run, processes and films that were started here."""
        with self._starting:
            if self._own is not None:
                self._own.close()
            self._previews.close()
            self._plans.close()
            self._measures.close()
            self.screen.close()
            self.recordings.close()
            self.exports.close()

    def _picture(self, query: Mapping[str, list[str]]) -> tuple[str, bytes]:
        recordings = self.recordings
        return _read("image/png", lambda: recordings.picture_of(recordings.find(query.get("recording", [""])[0])))

    def _scene_picture(self, query: Mapping[str, list[str]]) -> tuple[str, bytes]:
        return _read("image/webp", lambda: self.scenes.picture_of(query.get("name", [""])[0]))

    def _scenes(self, request: Mapping[str, Any]) -> dict[str, Any]:
        pictures = self.recordings.pictures()
        return {
            "folder": str(Path.cwd()),
            "scenes": [one | {"picture": pictures.get(one["scene"])} for one in self.scenes.list()],
        }

    def _delete(self, recording: object) -> dict[str, Any]:
        self.screen.forget(str(recording))
        self.exports.forget(str(recording))
        return self.recordings.delete(recording)

    def _fit(self, request: Mapping[str, Any]) -> dict[str, Any]:
        """Return the fit of a recording's garments on a body, which may be omitted if it is the only one."""
        path, body = self.recordings.find(request.get("recording")), request.get("body")
        with self._measuring:  # a page may ask twice for one that takes long
            found: dict[str, Any] = self._measure(path, stamp_of(path), None if body is None else str(body))
        return found

    def _sew(self, request: Mapping[str, Any]) -> dict[str, Any]:
        """Run the scene of a recording with an edge of another length, under new names. Raises BadInput."""
        path, eased = self.recordings.find(request.get("recording")), list[str]()
        edge = [request.get(name) for name in ("panel", "edge", "length")]

        def make() -> Run:
            scene, seams = sew_again(path, self.scenes.folder, *edge)
            eased.extend(seams)
            return Run.start(scene_file.read(scene, (), self.scenes.roots), scene.name, None, False)

        return self._begin(make) | {"eased": eased}

    def _open(self, request: Mapping[str, Any]) -> dict[str, Any]:
        path = self.scenes.find(request.get("scene"))
        text = read_scene(path)
        changed = self.scenes.changed.get(str(request.get("scene")))
        facts = {"text": text, "changed": changed, "own": self._own_file(path), "file": path.name}
        return facts | self._checked(text.removeprefix(MARK) if changed is None else changed, path)

    def _own_file(self, path: Path) -> bool:
        """Return whether a scene's file is the user's own, not one shipped with nuno."""
        return path.parent == self.scenes.folder or path in self.scenes.more.values()

    def _checked(self, text: str, path: Path) -> dict[str, Any]:
        return scenes.check(text, path, self.scenes.roots)

    def _loaded(self, request: Mapping[str, Any]) -> Loaded:
        return scenes.load(*self._text(request), self.scenes.roots)

    def _text(self, request: Mapping[str, Any]) -> tuple[str, Path]:
        """Return the scene's text in the page, and the scene's file. Raises BadInput."""
        text = request.get("text")
        if not isinstance(text, str):
            raise BadInput("a request about a scene has its text", field="text")
        return text.removeprefix(MARK), self.scenes.find(request.get("scene"))

    def _check(self, request: Mapping[str, Any]) -> dict[str, Any]:
        return self._checked(*self._text(request))

    def _change(self, request: Mapping[str, Any]) -> dict[str, Any]:
        """Set a value in the text, or remove it; return the new text and the result of its check."""
        text, path = self._text(request)
        place = request.get("path")
        if not isinstance(place, list) or not place or not all(isinstance(part, str | int) for part in place):
            raise BadInput("a change has the path of a field", field="path")
        where: yaml_lines.Path = tuple(place)
        if request.get("drop"):
            after = edit.drop(text, where, path.name)
        else:
            value, written = _value_of(request)
            after = edit.put(text, where, value, path.name, written)
        return {"text": after} | self._checked(after, path)

    def _save(self, request: Mapping[str, Any]) -> dict[str, Any]:
        text, path = self._text(request)
        folder = path.parent if path in self.scenes.more.values() else self.scenes.folder
        return scenes.save(text, str(request.get("before")), path, folder, request.get("name"))

    def _plan(self, request: Mapping[str, Any]) -> dict[str, Any]:
        return {"rows": self._plans.make(_page(request), scenes.plan, *self._text(request), self.scenes.roots)}

    def _leave(self, request: Mapping[str, Any]) -> dict[str, Any]:
        """Cancel the build or plan for a page that no longer waits for it."""
        (self._plans if request.get("plan") else self._previews).forget(_page(request))
        return {}

    def _run(self, request: Mapping[str, Any]) -> dict[str, Any]:
        text, path = self._text(request)
        loaded = scenes.load(text, path, self.scenes.roots)
        changed = text if text != read_scene(path).removeprefix(MARK) else None
        entry, paused = str(request.get("scene")), bool(request.get("paused"))
        return self._begin(lambda: Run.start(loaded, entry, changed, paused))

    def _resume(self, request: Mapping[str, Any]) -> dict[str, Any]:
        """Resume a recorded run up to a new total duration. Raises BadInput."""
        path, change = self.recordings.find(request.get("recording")), f"duration={request.get('duration')}"
        with resumed_scene(path, [change]) as (loaded, _):
            return self._begin(lambda: Run.resume(loaded, [str(path), "--set", change]))

    def _begin(self, make: Callable[[], Run]) -> dict[str, Any]:
        """Start a run, if none is going on. Raises BadInput."""
        with self._starting:
            if self._own is not None and self._own.going:
                raise BadInput("a run goes on already", value=self._own.name, remedy="stop it before")
            if self._own is not None:
                self._own.close()
            self._own = make()
            return self._own.tell()

    def _control(self, request: Mapping[str, Any]) -> dict[str, Any]:
        action = request.get("action")
        if action not in CONTROLS:
            raise BadInput("no such action", value=action, limit=", ".join(CONTROLS))
        if self._own is None:
            raise BadInput("no run goes on", remedy="start one with Run")
        item = {"item": str(request.get("item", ""))} if action in ("set", "add") else {}
        answer = self._own.control(action, **item)
        return self._own.tell() | {"changed": {name: answer.get(name) for name in ("field", "old", "new", "frame")}}

    def _see(self, request: Mapping[str, Any]) -> dict[str, Any]:
        """Build the cloth at the start of the text's scene. Raises BadInput."""
        return self._starts.see(self._loaded(request), _page(request), *self._text(request), self.scenes.roots)

    def _dyed(self, request: Mapping[str, Any]) -> dict[str, Any]:
        """Return the dyed cloth at the start of the text's scene, laid flat. Raises BadInput."""
        return self._dyed_cloth.see(_page(request), *self._text(request), self.scenes.roots)

    def _paint(self, request: Mapping[str, Any]) -> dict[str, Any]:
        """Add a stroke or a stencil to the text, or a stroke to the present run. Raises BadInput."""
        text, path = self._text(request)
        cells, _, _ = cloth_of(self._loaded(request))
        if request.get("live"):
            return self._control({"action": "add", "item": dye.live_item_of(request, cells)})
        item, picture = dye.item_of(request, cells, path, self._own_file(path))
        try:
            after = dye.put(text, item, path.name)
            # Building the cloth refuses items that lie beside it, before they are in the text.
            cloth_of(scenes.load(after, path, self.scenes.roots))
        except BadInput:
            if picture is not None:
                picture.unlink()
            raise
        return {"text": after} | self._checked(after, path)

    def _live(self, query: Mapping[str, list[str]]) -> tuple[str, bytes]:
        """Return the newest frame of the present run. Raises Refused if the page asks for another run."""
        run = self._own
        if run is None or run.live is None or query.get("run", [""])[0] != run.name:
            raise Refused(NOT_FOUND, "there is no such run")
        return run.live.tell(query)

    def _draw(self, request: Mapping[str, Any]) -> dict[str, Any]:
        """Carry out a request about lines on the shown cloth, by `nuno.studio.lines`. Raises BadInput."""
        action = request.get("does")
        if action in ("begin", "check", "export", "apply", "take_back"):
            of_run = () if action in ("begin", "check") else (self._own,)
            answer: dict[str, Any] = getattr(self._drawing, action)(request, *of_run)
            return answer
        if action != "keep":
            raise BadInput("no such request", value=action, limit="begin, check, keep, apply, take_back, export")
        text, path = self._text(request)
        after, numbers = self._drawing.keep(
            request, text, lambda changed: scenes.load(changed, path, self.scenes.roots)
        )
        return {"text": after, "numbers": numbers} | self._checked(after, path)


def _read(kind: str, find: Callable[[], Path]) -> tuple[str, bytes]:
    """Return the type and bytes of a picture. Raises Refused."""
    try:
        return kind, find().read_bytes()
    except (BadInput, OSError):
        raise Refused(NOT_FOUND, "there is no such picture") from None


def _of_one(act: Callable[[object], dict[str, Any]]) -> Act:
    """Return the answer to requests for one recording."""
    return lambda request: act(request.get("recording"))


def _page(request: Mapping[str, Any]) -> str:
    """Return the id of the page that sent a request."""
    return str(request.get("page"))[:40]


def _value_of(request: Mapping[str, Any]) -> tuple[Any, str | None]:
    """Return a value, and its YAML text if the user typed it; invalid YAML is taken as a string."""
    if "written" not in request:
        return request.get("value"), None
    written = str(request["written"])
    try:
        return yaml_lines.parse_value(written), written
    except BadInput:
        return written, None
