"""Files of a recording: made by `nuno export` in a process of its own, and handed to the browser."""

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
"""By the flag of `nuno export`: the ending of the file's name, and what it is."""
FAR = re.compile(r"^(\d+) of (\d+)$", re.MULTILINE)


class Exports:
    """Files of recordings, kept until the page is closed."""

    def __init__(self, recordings: Recordings) -> None:
        self._recordings = recordings
        self._folder = tempfile.TemporaryDirectory(prefix="nuno-")
        self._made: dict[tuple[str, str], tuple[tuple[int, int], Child]] = {}

    @property
    def folder(self) -> Path:
        """Where they lie, for this user alone."""
        return Path(self._folder.name)

    def export(self, request: Mapping[str, Any]) -> dict[str, Any]:
        """Have a file made, where it is not yet: how far that is from 0 to 1, its name and bytes, or what is wrong with
        it in words. Raises BadInput.
        """
        path, kind = self._recordings.find(request.get("recording")), str(request.get("kind"))
        if kind not in KINDS:
            raise BadInput("no such file can be made", value=kind, remedy=nearest(kind, KINDS))
        stamp = stamp_of(path)
        before = self._made.get((path.name, kind))
        going = before is not None and before[1].code is None  # of a file that grows, what it was when it began
        if before is None or (not going and (before[0] != stamp or (before[1].code and request.get("again")))):
            child = Child(["export", str(path), f"--{kind}", str(self._file(path.name, kind)), "--progress"])
            before = self._made[path.name, kind] = (stamp, child)
        child = before[1]
        code, found = child.code, FAR.findall(child.said)
        share = int(found[-1][0]) / max(1, int(found[-1][1])) if found else None
        file = self._file(path.name, kind)
        return {
            "making": code is None, "share": share, "name": file.name,
            "bytes": file.stat().st_size if code == 0 else None,
            "problem": FAR.sub("", child.said).strip().removeprefix(f"error: {path}: ") if code else "",
        }  # fmt: skip

    def file(self, query: Mapping[str, list[str]]) -> tuple[str, bytes]:
        """One that was made. Raises Refused."""
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
        """End what is being made of a recording, and remove what was."""
        for key in [key for key in self._made if key[0] == name]:
            _, child = self._made.pop(key)
            if child.code is None:
                child.end()
            self._file(*key).unlink(missing_ok=True)

    def close(self) -> None:
        """End what was begun here, and remove what was made."""
        for _, child in self._made.values():
            if child.code is None:
                child.end()
        self._folder.cleanup()
