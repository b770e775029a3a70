"""What the page asks for."""

from __future__ import annotations

import contextlib
import functools
import threading
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from nuno import registry
from nuno.draw.append import MARK, read_text
from nuno.pages.guard import Refused
from nuno.pages.server import NOT_FOUND, Server, Take
from nuno.pages.worker import Workshop
from nuno.recording.restore import resumed_scene
from nuno.scene import edit, yaml_lines
from nuno.scene.scene_file import Loaded
from nuno.studio import arrivals, paint, scenes
from nuno.studio.cloth import Starts
from nuno.studio.dyed import Dyed, cloth_of, worn
from nuno.studio.exports import Exports
from nuno.studio.files import FILE_ACTS, Files
from nuno.studio.lines import Drawing
from nuno.studio.recordings import Recordings
from nuno.studio.run import Run
from nuno.studio.screen import Screen
from nuno.supervision import runs
from nuno_schemas.dye_presets import PRESETS
from nuno_schemas.errors import BadInput
from nuno_schemas.look import DyeColour
from nuno_schemas.preset import Preset

# What presets look like where they are chosen: a dye by its colours, a fabric by its weight and by how it bends.

SHADES = ("light", "mid", "dark")


def swatches() -> dict[str, Any]:
    """Of each dye its colours from light to dark; of each fabric its areal density [g/m^2] and its bending rigidity,
    the mean of warp and weft [uN m].
    """
    model = registry.offering("nuno.models", "presets", "lists fabrics")
    return {
        "dyes": {name: _shades(dye.fields.get("colour", {})) for name, dye in PRESETS.items()},
        "fabrics": {preset.name: _feel(preset) for preset in model.presets()},
    }


def _shades(given: dict[str, str]) -> list[str]:
    colour = DyeColour.model_validate(given)
    return [str(getattr(colour, shade)) for shade in SHADES]


def _feel(preset: Preset) -> dict[str, float]:
    given = {one.name: one.given for one in preset.measures}
    bends = [value for name in ("bend_warp", "bend_weft") if (value := given.get(name)) is not None]
    return {"density": given["density"] or 0.0, "bend": sum(bends) / len(bends)}


ACTS = (
    "scenes", "open", "check", "change", "save", "plan", "run", "resume", "control", "now", "see", "draw", "dyed",
    "worn", "paint", "swatches", "leave",
)  # fmt: skip
"""What the page may ask for, each a method of a desk."""
LOOKS, PLANS = (60.0, 3 * 2**30), 900.0
"""What building the cloth for a page may take [s, bytes], and planning [s]: a first time compiles kernels."""
CONTROLS = ("pause", "resume", "step", "stop", "set", "add")
"""What a page may ask of a run, as `nuno control`."""
OF_FILMS = ("replay", "plots", "compare")
"""What it may ask of recordings that are replayed, each a method of a screen."""
OF_RECORDINGS = {"recording": "open", "picture": "draw", "delete": "delete"}
OF_RECORDINGS |= {name: name for name in ("verify", "verdict", "resumable")}
"""What it may ask of one recording, and which method of the recordings does it."""


class Desk:
    """One page's work, in the folder that it was started in."""

    def __init__(self) -> None:
        self.scenes, self.recordings = scenes.Scenes(Path()), Recordings(runs.RECORDINGS)
        self.screen = Screen(self.recordings)
        self._own: Run | None = None
        # Planning compiles kernels; a preview is for a look, and a run says itself what it takes.
        remedy = "run it, or make its triangles or cells larger"
        self._previews = Workshop("building the cloth for a look", LOOKS[0], remedy, LOOKS[1])
        self._plans = Workshop("planning", PLANS, "run it; its first frame is what takes long")
        self._starts, self._dyed_cloth = Starts(self._previews), Dyed(self._previews)
        self._drawing = Drawing(self._starts)
        self._starting = threading.Lock()
        self._schema, self._looks = functools.cache(scenes.schema), functools.cache(swatches)
        self.files, self.exports = Files(Path(), runs.RECORDINGS), Exports(self.recordings)

    def attach(self, run: str, entry: str, config: str | None = None) -> None:
        """Show a run that was started elsewhere, of the scene that the page calls so."""
        self._own = Run.attach(run, entry, config)

    def server(self) -> Server:
        """What serves the page, until it is closed."""
        told = {
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
        return Server("nuno.studio", self.act, told, Take(self.files.take, arrivals.MOST))

    def _begin_building(self) -> None:
        """The process that builds cloth takes seconds to begin: it has when a scene is opened."""
        with contextlib.suppress(BadInput):
            first = "hanging-sheet"
            self._see({"scene": first, "text": read_text(self.scenes.find(first)), "page": "first"})

    def act(self, request: Mapping[str, Any]) -> dict[str, Any]:
        """Carry out one request of the page's. Raises BadInput, which the page shows."""
        name = str(request.get("do"))
        if name == "delete":
            self.screen.forget(str(request.get("recording")))
            self.exports.forget(str(request.get("recording")))
        if name in OF_RECORDINGS:
            found: dict[str, Any] = getattr(self.recordings, OF_RECORDINGS[name])(request.get("recording"))
        elif name == "recordings":
            found = {"recordings": self.recordings.list()}
        elif name in OF_FILMS:
            found = getattr(self.screen, name)(request)
        elif name in FILE_ACTS:
            found = getattr(self.files, name)(request)
        elif name == "export":
            found = self.exports.export(request)
        elif name in ACTS:
            found = getattr(self, f"_{name}")(request)
        else:
            known = *ACTS, "recordings", "export", *FILE_ACTS, *OF_FILMS, *OF_RECORDINGS
            raise BadInput("no such request", value=name, limit=", ".join(known))
        return found

    def close(self) -> None:
        """End what was started here."""
        with self._starting:
            if self._own is not None:
                self._own.close()
            self._previews.close()
            self._plans.close()
            self.screen.close()
            self.recordings.close()
            self.exports.close()

    def _picture(self, query: Mapping[str, list[str]]) -> tuple[str, bytes]:
        found = self.recordings
        return _read("image/png", lambda: found.picture_of(found.find(query.get("recording", [""])[0])))

    def _scene_picture(self, query: Mapping[str, list[str]]) -> tuple[str, bytes]:
        return _read("image/webp", lambda: self.scenes.picture_of(query.get("name", [""])[0]))

    def _scenes(self, request: Mapping[str, Any]) -> dict[str, Any]:
        pictures = self.recordings.pictures()
        return {
            "folder": str(Path.cwd()),
            "scenes": [one | {"picture": pictures.get(one["scene"])} for one in self.scenes.list()],
        }

    def _swatches(self, request: Mapping[str, Any]) -> dict[str, Any]:
        return self._looks()

    def _open(self, request: Mapping[str, Any]) -> dict[str, Any]:
        path = self.scenes.find(request.get("scene"))
        text = read_text(path)
        changed = self.scenes.changed.get(str(request.get("scene")))
        facts = {"text": text, "changed": changed, "own": self._own_file(path), "file": path.name}
        return facts | self._checked(text.removeprefix(MARK) if changed is None else changed, path)

    def _own_file(self, path: Path) -> bool:
        """Whether a scene's file is the person's own, and not one that comes with nuno."""
        return path.parent == self.scenes.folder or path in self.scenes.more.values()

    def _checked(self, text: str, path: Path) -> dict[str, Any]:
        return scenes.check(text, path, self.scenes.roots)

    def _loaded(self, request: Mapping[str, Any]) -> Loaded:
        return scenes.load(*self._text(request), self.scenes.roots)

    def _text(self, request: Mapping[str, Any]) -> tuple[str, Path]:
        """What stands in the page, and the file that it stands for. Raises BadInput."""
        text = request.get("text")
        if not isinstance(text, str):
            raise BadInput("a request about a scene has its text", field="text")
        return text.removeprefix(MARK), self.scenes.find(request.get("scene"))

    def _check(self, request: Mapping[str, Any]) -> dict[str, Any]:
        return self._checked(*self._text(request))

    def _change(self, request: Mapping[str, Any]) -> dict[str, Any]:
        """Put a value into the text, or take it out; the new text, and what it says."""
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
        """End what is built for a page, which does not wait for it any more."""
        (self._plans if request.get("plan") else self._previews).forget(_page(request))
        return {}

    def _run(self, request: Mapping[str, Any]) -> dict[str, Any]:
        text, path = self._text(request)
        loaded = scenes.load(text, path, self.scenes.roots)
        changed = text if text != read_text(path).removeprefix(MARK) else None
        entry, paused = str(request.get("scene")), bool(request.get("paused"))
        return self._begin(lambda: Run.start(loaded, entry, changed, paused))

    def _resume(self, request: Mapping[str, Any]) -> dict[str, Any]:
        """Go on with a recording, until the whole run has a duration. Raises BadInput."""
        path, change = self.recordings.find(request.get("recording")), f"duration={request.get('duration')}"
        with resumed_scene(path, [change]) as (loaded, _):
            return self._begin(lambda: Run.resume(loaded, [str(path), "--set", change]))

    def _begin(self, make: Callable[[], Run]) -> dict[str, Any]:
        """Start a run, of which one goes on at a time. Raises BadInput."""
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

    def _now(self, request: Mapping[str, Any]) -> dict[str, Any]:
        return self._own.tell() if self._own is not None else {"state": "none"}

    def _see(self, request: Mapping[str, Any]) -> dict[str, Any]:
        """Build the cloth as it is at the start of a text's scene. Raises BadInput."""
        return self._starts.see(self._loaded(request), _page(request), *self._text(request), self.scenes.roots)

    def _dyed(self, request: Mapping[str, Any]) -> dict[str, Any]:
        """The dyed cloth of a text's scene as it begins, laid flat. Raises BadInput."""
        return self._dyed_cloth.see(_page(request), *self._text(request), self.scenes.roots)

    def _worn(self, request: Mapping[str, Any]) -> dict[str, Any]:
        """Where the triangles of a start that is shown lie on the flat cloth. Raises BadInput."""
        number = request.get("start")
        start = self._starts.kept.get(number) if isinstance(number, int) else None
        if start is None:
            raise BadInput("this start is no longer kept", field="start", remedy="load the page again")
        return {"corners": worn(start)}

    def _paint(self, request: Mapping[str, Any]) -> dict[str, Any]:
        """Put a stroke or a stencil into the text; or a stroke into the run that goes on. Raises BadInput."""
        text, path = self._text(request)
        cells, _, _ = cloth_of(self._loaded(request))
        if request.get("live"):
            return self._control({"action": "add", "item": paint.live_item_of(request, cells)})
        item, picture = paint.item_of(request, cells, path, self._own_file(path))
        try:
            after = paint.put(text, item, path.name)
            # What lies beside the cloth is refused before it is in the text.
            cloth_of(scenes.load(after, path, self.scenes.roots))
        except BadInput:
            if picture is not None:
                picture.unlink()
            raise
        return {"text": after} | self._checked(after, path)

    def _live(self, query: Mapping[str, list[str]]) -> tuple[str, bytes]:
        """The newest frame of the run that was started here, where it is the one that is asked for."""
        own = self._own
        if own is None or own.live is None or query.get("run", [""])[0] != own.name:
            raise Refused(NOT_FOUND, "there is no such run")
        return own.live.tell(query)

    def _draw(self, request: Mapping[str, Any]) -> dict[str, Any]:
        """Lines on the cloth that is shown: see `nuno.studio.lines`. Raises BadInput."""
        does = request.get("does")
        if does in ("begin", "check"):
            getattr(self._drawing, does)(request)
            return {}
        if does in ("export", "apply"):
            answer: dict[str, Any] = getattr(self._drawing, does)(request, self._own)
            return answer
        if does != "keep":
            raise BadInput("no such request", value=does, limit="begin, check, keep, apply, export")
        text, path = self._text(request)
        after = self._drawing.keep(request, text, lambda changed: scenes.load(changed, path, self.scenes.roots))
        return {"text": after} | self._checked(after, path)


def _read(kind: str, find: Callable[[], Path]) -> tuple[str, bytes]:
    """A picture. Raises Refused."""
    try:
        return kind, find().read_bytes()
    except (BadInput, OSError):
        raise Refused(NOT_FOUND, "there is no such picture") from None


def _page(request: Mapping[str, Any]) -> str:
    """What tells the page that asks from others."""
    return str(request.get("page"))[:40]


def _value_of(request: Mapping[str, Any]) -> tuple[Any, str | None]:
    """A value, and how it was typed where it was typed as YAML: what is none is a text."""
    if "written" not in request:
        return request.get("value"), None
    written = str(request["written"])
    try:
        return yaml_lines.parse_value(written), written
    except BadInput:
        return written, None
