"""Files of the folder beside its scenes: taken where they are dropped, told of, and made scenes of."""

from __future__ import annotations

import threading
from collections.abc import Mapping
from io import BufferedIOBase
from pathlib import Path
from typing import Any

from nuno.pages.guard import Refused
from nuno.pages.server import NOT_FOUND
from nuno.scene.files import stamp_of
from nuno.studio import offers
from nuno.studio.arrivals import MOST, Arrivals
from nuno.studio.file_summary import KINDS, Seen, files_of, look
from nuno_schemas.errors import BadInput

FILE_ACTS = ("files", "expect", "about", "make")
"""What the page may ask about files, each a method."""
LISTED = tuple(kind for kind in KINDS if kind not in (".yaml", ".yml", ".mcap"))
"""Endings of what is shown beside scenes and recordings, which have lists of their own."""


class Files:
    """Those of a folder; recordings go into another."""

    def __init__(self, folder: Path, recordings: Path) -> None:
        self.folder = folder
        self._arrivals = Arrivals(folder, {".mcap": recordings})
        self._seen: dict[Path, tuple[tuple[int, int], Seen]] = {}
        self._looking = threading.Lock()

    def take(self, name: str, stream: BufferedIOBase, length: int) -> dict[str, Any]:
        """A file that is dropped on the page; what it is and what can be done with it. Raises BadInput."""
        path, seen = self._arrivals.receive(name, stream, length, self._look_alone)
        if seen.kind != "scene":  # whose other files lie beside its place
            self._seen[path] = (stamp_of(path), seen)
        return self._told(path)

    def files(self, request: Mapping[str, Any]) -> dict[str, Any]:
        """Names of what can be told of, the newest first, and what may be dropped."""
        names = [path.name for path in files_of(self.folder, LISTED)]
        return {"files": names, "kinds": sorted(KINDS), "most": MOST}

    def expect(self, request: Mapping[str, Any]) -> dict[str, Any]:
        """Before a file is sent: whether it may be. Raises BadInput."""
        return {"name": self._arrivals.expect(request.get("name"), request.get("bytes"))}

    def about(self, request: Mapping[str, Any]) -> dict[str, Any]:
        """What a file of the folder is, and what can be done with it. Raises BadInput."""
        return self._told(self._find(request.get("file")))

    def make(self, request: Mapping[str, Any]) -> dict[str, Any]:
        """Do what is offered for a file; the name of the scene that was written. Raises BadInput."""
        chosen = request.get("chosen")
        path = self._find(request.get("file"))
        scene = offers.make(path, self._look, request.get("offer"), chosen if isinstance(chosen, dict) else {})
        return {"scene": scene.name}

    def picture(self, query: Mapping[str, list[str]]) -> tuple[str, bytes]:
        """What is to be seen of a file. Raises Refused."""
        try:
            picture = self._look(self._find(query.get("file", [""])[0])).picture
        except BadInput:
            picture = b""
        if not picture:
            raise Refused(NOT_FOUND, "there is no such picture")
        return "image/png", picture

    def _find(self, name: object) -> Path:
        path = next((one for one in files_of(self.folder, tuple(KINDS)) if one.name == name), None)
        if path is None:
            raise BadInput("no such file here", value=name, remedy="load the list again")
        return path

    def _look_alone(self, path: Path) -> Seen:
        """One after the other: what is read whole may be large."""
        with self._looking:
            return look(path)

    def _look(self, path: Path) -> Seen:
        """Once for as long as the file is the same: a mesh takes seconds."""
        with self._looking:
            stamp = stamp_of(path)
            if self._seen.get(path, (None,))[0] != stamp:
                self._seen[path] = (stamp, look(path))
            return self._seen[path][1]

    def _told(self, path: Path) -> dict[str, Any]:
        seen = self._look(path)
        return {
            "file": path.name, "kind": seen.kind, "title": seen.title, "rows": seen.rows, "mistakes": seen.mistakes,
            "pictured": bool(seen.picture), "offers": offers.describe(offers.offers_for(seen), path.parent),
        }  # fmt: skip
