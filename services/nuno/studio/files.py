"""Files of the studio's folder: accepted when dropped on the page, described, and turned into scenes."""

from __future__ import annotations

import threading
from collections.abc import Mapping
from io import BufferedIOBase
from pathlib import Path
from typing import Any

from nuno.scene.files import stamp_of
from nuno.studio import offers
from nuno.studio.arrivals import MOST, Arrivals
from nuno.studio.file_summary import KINDS, Seen, files_of, look
from nuno.studio.pages.guard import Refused
from nuno.studio.pages.server import NOT_FOUND
from nuno_schemas.errors import BadInput

FILE_ACTS = ("files", "expect", "about", "make")
"""Requests about files, each a method."""
LISTED = tuple(kind for kind in KINDS if kind not in (".yaml", ".yml", ".mcap"))
"""Endings of listed files: those of scenes and recordings have lists of their own."""


class Files:
    """The files of a folder; dropped recordings go into another folder."""

    def __init__(self, folder: Path, recordings: Path) -> None:
        self.folder = folder
        self._arrivals = Arrivals(folder, {".mcap": recordings})
        self._seen: dict[Path, tuple[tuple[int, int], Seen]] = {}
        self._looking = threading.Lock()

    def take(self, name: str, stream: BufferedIOBase, length: int) -> dict[str, Any]:
        """Take a file that is dropped on the page, and describe it with its offers. Raises BadInput."""
        path, seen = self._arrivals.receive(name, stream, length, self._look_alone)
        if seen.kind != "scene":  # a scene names files next to its final place
            self._seen[path] = (stamp_of(path), seen)
        return self._describe(path)

    def files(self, request: Mapping[str, Any]) -> dict[str, Any]:
        """Return the names of the listed files, newest first, and the endings and size of files that may be dropped."""
        names = [path.name for path in files_of(self.folder, LISTED)]
        return {"files": names, "kinds": sorted(KINDS), "most": MOST}

    def expect(self, request: Mapping[str, Any]) -> dict[str, Any]:
        """Return the name that a file will get, before it is sent. Raises BadInput if it would be refused."""
        return {"name": self._arrivals.expect(request.get("name"), request.get("bytes"))}

    def about(self, request: Mapping[str, Any]) -> dict[str, Any]:
        """Describe a file of the folder with its offers. Raises BadInput."""
        return self._describe(self._find(request.get("file")))

    def make(self, request: Mapping[str, Any]) -> dict[str, Any]:
        """Carry out an offer for a file, and return the name of the new scene. Raises BadInput."""
        chosen = request.get("chosen")
        path = self._find(request.get("file"))
        scene = offers.make(path, self._look, request.get("offer"), chosen if isinstance(chosen, dict) else {})
        return {"scene": scene.name}

    def picture(self, query: Mapping[str, list[str]]) -> tuple[str, bytes]:
        """Return the picture of a file. Raises Refused."""
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
        """Read a file, one at a time because files may be large."""
        with self._looking:
            return look(path)

    def _look(self, path: Path) -> Seen:
        """Read a file once until it changes: a mesh takes seconds."""
        with self._looking:
            stamp = stamp_of(path)
            if self._seen.get(path, (None,))[0] != stamp:
                self._seen[path] = (stamp, look(path))
            return self._seen[path][1]

    def _describe(self, path: Path) -> dict[str, Any]:
        seen = self._look(path)
        return {
            "file": path.name, "kind": seen.kind, "title": seen.title, "rows": seen.rows, "mistakes": seen.mistakes,
            "pictured": bool(seen.picture), "offers": offers.describe(offers.offers_for(seen), path.parent),
        }  # fmt: skip
