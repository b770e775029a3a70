"""The render service: draws yarns of some frames by ray tracing, and publishes the pictures.

Frames are queued as they arrive and drawn in a separate thread, so that the cloth never waits for a picture; at the end
of the run, the queue is drawn before the recording is closed.
"""

from __future__ import annotations

import contextlib
import queue
import threading
import time
from typing import Any

from nuno.bus.encodings import BadMessage, decode_points, encode_picture
from nuno.bus.messages import Inbox, Message, Query
from nuno.exports.yarns import Artist
from nuno.recording.recorded import Frame
from nuno.runtime.service import Context, asks_to_finish, each_message
from nuno_schemas.errors import BadInput
from nuno_schemas.messages import PICTURE, STATE


class Render:
    """Draws the pictures of one run."""

    def __init__(self, context: Context, artist: Artist) -> None:
        scene = context.loaded.scene
        self.context, self.artist = context, artist
        every = scene.view.pictures
        self.every = None if every == "end" or every is None else scene.in_frames(every)
        """Frames from one picture to the next; None draws only the last frame."""
        self.last: Frame | None = None
        self.queued = -1
        """The newest queued frame."""
        self.pictures, self.undrawn, self.seconds = 0, 0, 0.0
        self._frames: queue.SimpleQueue[Frame | None] = queue.SimpleQueue()
        self._thread = threading.Thread(target=self._draw_all, name="pictures", daemon=True)
        self._thread.start()

    def take(self, message: Message) -> None:
        """Keep a frame, and queue it if it is due. Raises BadMessage."""
        header = message.header
        self.last = Frame(header.frame, header.t, header.digest, decode_points(message.payload))
        if self.every is not None and (self.queued < 0 or header.frame % self.every == 0):
            self._queue(self.last)

    def end(self, draw_last: bool) -> None:
        """End after the queue and the last frame; without `draw_last`, drop the queue."""
        if not draw_last:
            self.drop()
        elif self.last is not None and self.last.number != self.queued:
            self._queue(self.last)
        self._frames.put(None)

    def drop(self) -> None:
        """Drop the queue."""
        with contextlib.suppress(queue.Empty):
            while self._frames.get_nowait() is not None:
                self.undrawn += 1
            self._frames.put(None)

    @property
    def drawing(self) -> bool:
        """Whether pictures are still being drawn."""
        return self._thread.is_alive()

    def summary(self) -> dict[str, Any]:
        """Return the numbers of drawn and dropped pictures, and the time [s]."""
        return {"pictures": self.pictures, "seconds": self.seconds, "undrawn": self.undrawn}

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
    """Draw one run until the query to finish. Raises BadInput for a scene that cannot be drawn."""
    inbox = Inbox(context.bus, [STATE])
    render = Render(context, Artist(context.loaded))

    def handle(message: Message) -> None:
        try:
            render.take(message)
        except BadMessage:
            inbox.refuse(message)

    query = each_message(context, inbox, handle)
    while isinstance(item := inbox.get(0), Message):
        handle(item)
    queries = [query]
    render.end(draw_last=not query.json().get("error"))
    while render.drawing:
        again = inbox.get(0.1)
        if isinstance(again, Query) and asks_to_finish(inbox, again):  # the user would not wait
            render.drop()
            queries.append(again)
    for each in queries:
        each.answer_json(context.counts(inbox) | render.summary())
