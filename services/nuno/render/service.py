"""The render service: draws yarns of some frames by rays, and publishes the pictures.

Frames are taken in as they come and drawn in a thread of their own, so that the cloth never waits for a picture; at the
end of the run what is left is drawn before the recording is closed.
"""

from __future__ import annotations

import queue
import threading
import time
from typing import Any

from nuno.recording.recorded import Frame
from nuno.render.artist import Artist
from nuno.service import Context, each_message
from nuno.wire.arrays import BadMessage, decode_points, encode_picture
from nuno.wire.bus import Inbox, Message
from nuno_schemas.errors import BadInput
from nuno_schemas.messages import PICTURE, STATE


class Render:
    """Pictures of one run."""

    def __init__(self, context: Context, artist: Artist) -> None:
        scene = context.loaded.scene
        self.context, self.artist = context, artist
        every = scene.view.pictures
        self.every = None if every == "end" or every is None else max(1, round(every * scene.frame_rate))
        """Frames between two pictures; None: the last frame alone."""
        self.last: Frame | None = None
        self.queued = -1
        """The newest frame that is to be drawn."""
        self.pictures, self.seconds = 0, 0.0
        self._frames: queue.SimpleQueue[Frame | None] = queue.SimpleQueue()
        self._thread = threading.Thread(target=self._draw_all, name="pictures", daemon=True)
        self._thread.start()

    def take(self, message: Message) -> None:
        """Keep a frame, and have it drawn if it is due. Raises BadMessage."""
        header = message.header
        self.last = Frame(header.frame, header.t, header.digest, decode_points(message.payload))
        if self.every is not None and (self.queued < 0 or header.frame % self.every == 0):
            self._queue(self.last)

    def finish(self, draw_last: bool) -> dict[str, Any]:
        """Draw the last frame, unless it has been, and wait for all pictures; without it those are left undrawn."""
        if not draw_last:
            while not self._frames.empty():
                self._frames.get()
        elif self.last is not None and self.last.number != self.queued:
            self._queue(self.last)
        self._frames.put(None)
        self._thread.join()
        return {"pictures": self.pictures, "seconds": self.seconds}

    def _queue(self, frame: Frame) -> None:
        self.queued = frame.number
        self._frames.put(frame)

    def _draw_all(self) -> None:
        while (frame := self._frames.get()) is not None:
            start = time.perf_counter()
            try:
                picture = self.artist.draw(frame)
            except BadInput as error:
                self.context.event("warning", f"no picture of frame {frame.number}: {error}", frame.number, frame.t)
                continue
            self.context.bus.publisher(PICTURE).put(encode_picture(picture, frame.t), frame.number, frame.t)
            self.pictures += 1
            self.seconds += time.perf_counter() - start


def main(context: Context) -> None:
    """Draw one run until asked to finish. Raises BadInput for a scene that cannot be drawn."""
    inbox = Inbox(context.bus, [STATE])
    render = Render(context, Artist(context.loaded))

    def handle(message: Message) -> None:
        try:
            render.take(message)
        except BadMessage:
            inbox.refuse(message)

    question = each_message(context, inbox, handle)
    while isinstance(item := inbox.get(0), Message):
        handle(item)
    drawn = render.finish(not question.json().get("error"))
    question.answer_json(context.counts(inbox) | drawn)
