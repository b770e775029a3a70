"""Lines drawn on cloth in the page: checked, added to a run, written into a scene's text, exported."""

from __future__ import annotations

import contextlib
import json
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

from nuno.bus.encodings import BadMessage
from nuno.scene.scene_file import Loaded
from nuno.studio import draw
from nuno.studio.cloth import Start, Starts
from nuno.studio.draw import Stroke, by_object, line_at, piece_of, pieces_of, read_strokes, require_lines, to_obj
from nuno.studio.live_view import Sight
from nuno.studio.run import Run
from nuno.studio.server import describe
from nuno_schemas.errors import BadInput, RunFailed

# Errors name the line of the page that they are about.

_LINE = re.compile(r"lines\[(\d+)\]")
_TRIANGLE = re.compile(r"triangle (\d+)")


def name_line(error: BadInput, strokes: Sequence[Stroke], which: Sequence[int], sight: Sight) -> BadInput:
    """Return the error with the field of one of the page's lines; those of the numbers `which` were checked.

    If the error names a triangle that two lines must not both cross, it is the later line.
    """
    line, triangle = _LINE.search(error.field or ""), _TRIANGLE.search(str(error.value))
    if line is not None and int(line[1]) < len(which):
        number = which[int(line[1])]
    elif triangle is not None:
        piece = piece_of(sight, int(sight.faces[strokes[which[0]].points[0][0], 0]))
        number = which[line_at([strokes[i] for i in which], piece, int(triangle[1]), sight)]
    else:
        return error
    return replace(error, field=f"lines[{number}]")


Load = Callable[[str], Loaded]


class Drawing:
    """Requests of a page that draws on a start (`start`, its number), or on the present run (`run`, `shape`)."""

    def __init__(self, starts: Starts) -> None:
        self._starts = starts

    def begin(self, request: Mapping[str, Any]) -> dict[str, Any]:
        """Return what lines on a start need, by `require_lines`. Raises BadInput."""
        start = self._start(request)
        return require_lines(start.loaded, start.objects)

    def check(self, request: Mapping[str, Any]) -> dict[str, Any]:
        """Apply lines to a copy of the cloth at its start. Raises BadInput for the first line that is impossible."""
        start = self._start(request)
        strokes, sight = read_strokes(request.get("lines"), start.sight), start.sight
        for which in pieces_of(strokes, sight).values():
            (operation,) = draw.as_operations(by_object([strokes[i] for i in which], sight), request.get("settings"))
            try:
                start.trial.apply(operation)
            except BadInput as error:
                raise name_line(error, strokes, which, sight) from None
        return {}

    def keep(self, request: Mapping[str, Any], text: str, load: Load) -> tuple[str, list[tuple[str, int]]]:
        """Return a text with lines that were drawn on a start, and the object and number of each. Raises BadInput."""
        start = self._start(request)
        strokes = read_strokes(request.get("lines"), start.sight)
        lines = {exact: by_object(strokes, start.sight, exact) for exact in (True, False)}
        name, settings = start.loaded.path.name, request.get("settings")
        after, first = draw.with_lines(text, name, start.sight, lines, settings, load)
        return after, draw.numbered(pieces_of(strokes, start.sight), first)

    def export(self, request: Mapping[str, Any], run: Run | None) -> dict[str, Any]:
        """Return the lines as the text of an OBJ file, which the browser saves. Raises BadInput."""
        sight = self._start(request).sight if "start" in request else _sight(run, request)
        name = self._start(request).loaded.scene.name if "start" in request else sight.run
        return {"name": f"{name}-lines.obj", "text": to_obj(read_strokes(request.get("lines"), sight), sight)}

    def apply(self, request: Mapping[str, Any], run: Run | None) -> dict[str, Any]:
        """Add lines to the run, object by object; return which are applied, with the object and number of each, and the
        first error.
        """
        sight = _sight(run, request)
        assert run is not None and run.live is not None
        strokes = read_strokes(request.get("lines"), sight)
        refused: dict[str, Any] = {}
        applied, numbers = list[int](), list[tuple[str, int]]()
        for name, which in pieces_of(strokes, sight).items():
            own = by_object([strokes[i] for i in which], sight)
            (operation,) = draw.as_operations(own, request.get("settings"))
            try:
                answer = run.control("add", item=f"{operation.pop('plugin')}: {json.dumps(operation)}")
            except BadInput as error:
                refused = {"ok": False} | describe(name_line(error, strokes, which, sight))
                break
            applied += which
            numbers += draw.numbered({name: which}, {name: int(answer["new"]["first"])})
        if run.live.follower is not None:
            with contextlib.suppress(RunFailed, BadMessage):
                run.live.follower.see()
        return {"applied": applied, "numbers": numbers} | refused

    def take_back(self, request: Mapping[str, Any], run: Run | None) -> dict[str, Any]:
        """Take a line back from the run, by its object and number. Raises BadInput."""
        if run is None:
            raise BadInput("no run goes on", remedy="start one with Run")
        fields = {"object": request.get("object"), "take_back": [request.get("number")]}
        run.control("add", item=f"{draw.OPERATION}: {json.dumps(fields)}")
        return {}

    def _start(self, request: Mapping[str, Any]) -> Start:
        number = request.get("start")
        start = self._starts.kept.get(number) if isinstance(number, int) else None
        if start is None:
            remedy = "go back to the start, and try again"
            raise BadInput("the start that the lines were drawn on is no longer kept", field="start", remedy=remedy)
        return start


def _sight(run: Run | None, request: Mapping[str, Any]) -> Sight:
    """Return the shown state of a run. Raises BadInput if the page drew on another one."""
    if run is None or not run.going or run.live is None:
        raise BadInput("no run goes on", remedy="start one with Run")
    sight = run.live.board.now
    if request.get("shape") != sight.shape:
        remedy = "try again: the lines have moved along"
        raise BadInput("the cloth's triangles have changed meanwhile", field="shape", remedy=remedy)
    return sight
