"""Exported files of a recording: made by `nuno export` in another process, and sent to the browser."""

from __future__ import annotations

import re
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from nuno.pages.command_process import Child
from nuno.pages.guard import Refused
from nuno.pages.server import NOT_FOUND
from nuno.scene.files import stamp_of
from nuno.studio.recordings import Recordings, run_of
from nuno_schemas.errors import BadInput, nearest

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
        self._made: dict[tuple[str, str], tuple[tuple[int, int], Child]] = {}

    @property
    def folder(self) -> Path:
        """Folder of the files, readable by this user alone."""
        return Path(self._folder.name)

    def export(self, request: Mapping[str, Any]) -> dict[str, Any]:
        """Start the export of a file, unless it is done or going on; return its progress from 0 to 1, its name and
        bytes, or its error. Raises BadInput.
        """
        path, kind = self._recordings.find(request.get("recording")), str(request.get("kind"))
        if kind not in KINDS:
            raise BadInput("no such file can be made", value=kind, remedy=nearest(kind, KINDS))
        stamp = stamp_of(path)
        before = self._made.get((path.name, kind))
        going = before is not None and before[1].code is None  # the file may have grown since its start
        if before is None or (not going and (before[0] != stamp or (before[1].code and request.get("again")))):
            child = Child(["export", str(path), f"--{kind}", str(self._file(path.name, kind)), "--progress"])
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
        folder = self.folder / recording
        folder.mkdir(exist_ok=True)
        return folder / f"{run_of(recording)}{KINDS[kind][0]}"

    def forget(self, name: str) -> None:
        """Stop the exports of a recording, and remove its files."""
        for key in [key for key in self._made if key[0] == name]:
            _, child = self._made.pop(key)
            if child.code is None:
                child.end()
            self._file(*key).unlink(missing_ok=True)

    def close(self) -> None:
        """Stop all exports, and remove all files."""
        for _, child in self._made.values():
            if child.code is None:
                child.end()
        self._folder.cleanup()
