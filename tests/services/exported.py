"""Pictures and messages for exports, and what a reader finds in them."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
from PIL import Image
from recorded_sheet import Item, metadata

from nuno.recording.reader import open_recording
from nuno.recording.writer import RecordingWriter

FAR = np.array([1e6, -1e6, 1e6 + 0.25])


def picture(width: int = 8, height: int = 4) -> Image.Image:
    values = np.arange(width * height * 3, dtype=np.uint8).reshape(height, width, 3)
    return Image.fromarray(values)


def png(image: Image.Image) -> bytes:
    stream = io.BytesIO()
    image.save(stream, "PNG")
    return stream.getvalue()


def seen(recording: Path, number: int) -> np.ndarray:
    """Positions of a frame as recorded: float32 about an origin."""
    with open_recording(recording) as opened:
        return next(f.x for f in opened.frames() if f.number == number)


def write_items(path: Path, found: list[Item]) -> None:
    writer = RecordingWriter(path, metadata(), {})
    for topic, header, payload in found:
        writer.write(topic, header, payload)
    writer.finish({})
