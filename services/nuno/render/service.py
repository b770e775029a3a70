"""The render service: draws yarns of some frames by rays, and publishes the pictures.

Frames are taken in as they come and drawn in a thread of their own, so that the cloth never waits for a picture; at the
end of the run what is left is drawn before the recording is closed.
"""

from __future__ import annotations

import contextlib
import queue
import threading
import time
from typing import Any

from nuno.bus.encodings import BadMessage, decode_points, encode_picture
from nuno.bus.messages import Inbox, Message
from nuno.bus.query import Query
from nuno.recording.recorded import Frame
from nuno.render.artist import Artist
from nuno.service import Context, asks_to_finish, each_message
from nuno_schemas.errors import BadInput
from nuno_schemas.messages import PICTURE, STATE


class Render:
    """Pictures of one run."""

    def __init__(self, context: Context, artist: Artist) -> None:
        scene = context.loaded.scene
        self.context, self.artist = context, artist
        every = scene.view.pictures
        self.every = None if every == "end" or every is None else scene.in_frames(every)
        """Frames between two pictures; None: the last frame alone."""
        self.last: Frame | None = None
        self.queued = -1
        """The newest frame that is to be drawn."""
        self.pictures, self.undrawn, self.seconds = 0, 0, 0.0
        self._frames: queue.SimpleQueue[Frame | None] = queue.SimpleQueue()
        self._thread = threading.Thread(target=self._draw_all, name="pictures", daemon=True)
        self._thread.start()

    def take(self, message: Message) -> None:
        """Keep a frame, and have it drawn if it is due. Raises BadMessage."""
        header = message.header
        self.last = Frame(header.frame, header.t, header.digest, decode_points(message.payload))
        if self.every is not None and (self.queued < 0 or header.frame % self.every == 0):
            self._queue(self.last)

    def end(self, draw_last: bool) -> None:
        """Draw the last frame, unless it has been, and no more; without it those that wait are left undrawn."""
        if not draw_last:
            self.drop()
        elif self.last is not None and self.last.number != self.queued:
            self._queue(self.last)
        self._frames.put(None)

    def drop(self) -> None:
        """Leave undrawn what waits."""
        with contextlib.suppress(queue.Empty):
            while self._frames.get_nowait() is not None:
                self.undrawn += 1
            self._frames.put(None)

    @property
    def drawing(self) -> bool:
        """Whether there are pictures to wait for."""
        return self._thread.is_alive()

    def told(self) -> dict[str, Any]:
        """What was drawn, and what was not."""
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
    questions = [question]
    render.end(draw_last=not question.json().get("error"))
    while render.drawing:
        again = inbox.get(0.1)
        if isinstance(again, Query) and asks_to_finish(inbox, again):  # the user would not wait
            render.drop()
            questions.append(again)
    for each in questions:
        each.answer_json(context.counts(inbox) | render.told())
