"""A rerun file, written as messages come."""

from __future__ import annotations

from pathlib import Path

import rerun as rr

from nuno.viewer.bridge import APPLICATION, Bridge
from nuno.viewer.require import part_of
from nuno_schemas.errors import RunFailed
from nuno_schemas.scene import View

FLUSH_SECONDS = 60.0


class RerunFile:
    """Writes `path` + ".part", which gets its name when it is whole.

    run  the recording's id in rerun. Every message handed to `feed` is written.
    """

    def __init__(self, path: Path, run: str, view: View | None = None) -> None:
        self.path = path
        self._recording = rr.RecordingStream(APPLICATION, recording_id=run, send_properties=False)
        self._recording.save(part_of(path))
        self.bridge = Bridge(self._recording, view)

    def feed(self, topic: str, frame: int, t: float, payload: bytes) -> None:
        """Write one message. Raises BadMessage."""
        self.bridge.feed(topic, frame, t, payload)

    def abort(self) -> None:
        """Stop writing and leave nothing behind."""
        self._recording.disconnect()
        part_of(self.path).unlink(missing_ok=True)

    def finish(self) -> Path:
        """Write what is left and give the file its name. Raises RunFailed if it cannot be written."""
        part = part_of(self.path)
        try:
            self._recording.flush(timeout_sec=FLUSH_SECONDS)
            self._recording.disconnect()
            part.replace(self.path)
        except (OSError, RuntimeError, ValueError) as error:
            raise RunFailed(f"the rerun file could not be written: {error}; {part} holds what was") from None
        return self.path
