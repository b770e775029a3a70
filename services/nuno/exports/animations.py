"""GIF and MP4 animations of a recording."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from nuno.exports.cloth import read_frame
from nuno.exports.dyed_pictures import PAPER, Changes, choose_amounts, draw_amounts, dyed_pictures
from nuno.exports.pictures import (
    PLAIN_RENDERING,
    Colour,
    Painter,
    Picture,
    Rendering,
    check_colour,
    check_sides,
    choose_frames,
    draw_frames,
    draw_turn,
    require_drawable,
)
from nuno.output_files import RATE, Progress, check_target, load_extra, writing
from nuno.recording.reader import Recording, opened
from nuno_schemas.errors import BadInput, RunFailed

if TYPE_CHECKING:
    from PIL import Image

GIF_RATES = (50.0, 25.0, 20.0, 12.5, 10.0, 5.0, 4.0, 2.5, 2.0, 1.0)
"""Pictures a second that a GIF's hundredths of a second give exactly."""
SIZE, DYED_SIDE = (640, 480), 500
"""Size of a moving cloth's pictures, and approximate longer side of a dyed cloth's pictures."""
DYED_SECONDS = 5.0
"""Length of an animation of a whole dyeing [s]."""
PALETTE_PICTURES, PALETTE_PIXELS, PALETTE_POWER = 8, 300_000, 0.7


@dataclass(frozen=True)
class Shot:
    """What an animation shows: a run from `start` to `end` [s]; or with `turn` the camera's way, in this time [s], once
    round one frame, by default the last. `shutter`: the share of a picture's time in which its shutter is open, which
    blurs what moves.
    """

    start: float | None = None
    end: float | None = None
    turn: float | None = None
    frame: int | None = None
    shutter: float = 0.0


def export_animation(
    source: Recording | Path | str,
    path: Path,
    size: tuple[int, int] | None = None,
    fps: float | None = None,
    shot: Shot | None = None,
    progress: Progress | None = None,
    colour: Colour = "auto",
    changes: Changes | None = None,
    rendering: Rendering = PLAIN_RENDERING,
) -> Path:
    """Draw a shot of a recording, by default all of it, as .gif or .mp4. Moving cloth is shown in real time, at `fps`
    or else RATE pictures a second. A dyeing without motion, which takes hours, has one picture per frame, at a rate at
    which all take DYED_SECONDS, but no more than RATE.

    Moving cloth is painted by `colour` (pictures.py); all else follows the scene and the changes. A GIF's rate is one
    of GIF_RATES, the nearest where none is asked for. Raises BadInput for another ending, a size, rate or colour out of
    range, an MP4's odd side, nothing to show, or (MP4) if imageio-ffmpeg is not installed; RunFailed if the encoder
    fails.
    """
    encoder, shot = check_animation(path, fps, size), shot or Shot()
    check_colour(colour)
    with ExitStack() as stack:
        recording = stack.enter_context(opened(source))
        frames: list[Any]
        draw: Callable[..., Iterator[Picture]]
        if recording.dyed_alone:
            frames = choose_amounts(recording, shot.start, shot.end)
            rate = _rate(encoder, fps or min(RATE, max(1.0, len(frames) / DYED_SECONDS)))
            draw = partial(draw_amounts, stack.enter_context(dyed_pictures(recording, changes, DYED_SIDE)))
        else:
            rate = _rate(encoder, fps or RATE)
            paint = partial(Painter, recording, size=size or SIZE, colour=colour, changes=changes, rendering=rendering)
            if shot.turn is None:
                frames = choose_frames(recording, rate, shot.start, shot.end)
                draw = partial(draw_frames, recording, paint, shutter=shot.shutter / rate)
            else:
                require_drawable(shot.turn * rate)
                frames = list(range(max(1, round(shot.turn * rate))))
                draw = partial(draw_turn, paint, read_frame(recording, shot.frame))
        # Evenly spaced frames determine a GIF's palette.
        samples = [frames[k] for k in np.linspace(0, len(frames) - 1, PALETTE_PICTURES).round().astype(int)]
        if encoder is not None:
            with writing(path, ".mp4") as new:
                _write_mp4(encoder, new, draw(frames, progress=progress), rate)
        else:
            palette = _choose_palette(draw(samples))
            with writing(path, ".gif") as new:
                _write_gif(new, draw(frames, progress=progress), rate, palette)
    return path


def _rate(encoder: Any, fps: float) -> float:
    """Return the rate of a file [pictures/s]: `fps` for an MP4, the nearest possible for a GIF."""
    return fps if encoder is not None else min(GIF_RATES, key=lambda rate: abs(rate - fps))


def check_animation(path: Path, fps: float | None, size: tuple[int, int] | None = None) -> Any:
    """Return the MP4 encoder, None for a GIF. Raises BadInput."""
    check_sides(size)
    suffix = path.suffix.lower()
    if suffix not in (".gif", ".mp4"):
        remedy = "change the ending"
        raise BadInput("no such kind of animation", value=str(path), limit=".gif or .mp4", remedy=remedy)
    if fps is not None and not 1.0 <= fps <= 240.0:
        raise BadInput("no such rate", field="--fps", value=fps, limit="1 to 240 pictures a second")
    if suffix == ".gif" and fps is not None and fps not in GIF_RATES:
        limit = f"a GIF's pictures last hundredths of a second: {', '.join(f'{rate:g}' for rate in GIF_RATES)} a second"
        remedy = f"--fps {min(GIF_RATES, key=lambda rate: abs(rate - fps)):g}, or write an .mp4"
        raise BadInput("a GIF cannot have this rate", field="--fps", value=fps, limit=limit, remedy=remedy)
    if suffix == ".mp4" and size is not None and any(side % 2 for side in size):
        width, height = size
        remedy = f"--size {width // 2 * 2}x{height // 2 * 2}, or write a .gif"
        limit = "an MP4 has an even number of pixels a side"
        raise BadInput("an MP4 cannot have this size", field="--size", value=size, limit=limit, remedy=remedy)
    check_target(path, suffix)
    if suffix == ".gif":
        return None
    return load_extra(("imageio_ffmpeg",), "MP4 needs imageio-ffmpeg", "video", "export a .gif")


def _choose_palette(pictures: Iterator[Picture]) -> Image.Image:
    """Return 256 colours for all pictures of a GIF, from some of them: with a palette for each, still areas flicker.

    Colours (to 6 bits) are weighted by a power of their area. Weighted by area, a plain background
    takes most entries and cloth shows bands; with equal weights, the shades of the cloth take them,
    and the background turns to noise. The first picture alone lacks the colours of later stretch.
    Mean error of a sheet on a sphere, dither averaged out, of 255: 3.5 from the first picture, 3.7
    with equal weights, 0.7 with this power.
    """
    from PIL import Image

    weights: Counter[int] = Counter()
    for picture in pictures:
        every = max(1, round(np.sqrt(picture.shape[0] * picture.shape[1] / PALETTE_PIXELS)))
        red, green, blue = np.moveaxis(picture[::every, ::every].astype(np.int32) & 0xFC, 2, 0)
        codes, areas = np.unique(red << 16 | green << 8 | blue, return_counts=True)
        weights.update(dict(zip(codes.tolist(), areas.tolist(), strict=True)))
    weighted = np.repeat(list(weights.keys()), [math.ceil(area**PALETTE_POWER) for area in weights.values()])
    sample = np.stack([weighted >> 16, weighted >> 8 & 255, weighted & 255], axis=-1).astype(np.uint8)
    return Image.fromarray(sample[None]).quantize(256, Image.Quantize.MEDIANCUT)


def _write_gif(path: Path, pictures: Iterator[Picture], rate: float, palette: Image.Image) -> None:
    from PIL import Image

    def indexed(picture: Picture) -> Image.Image:
        return Image.fromarray(picture).quantize(palette=palette, dither=Image.Dither.FLOYDSTEINBERG)

    first, rest = indexed(next(pictures)), map(indexed, pictures)
    # Pillow joins equal pictures into one of longer duration, so that the timing is kept.
    first.save(path, save_all=True, append_images=rest, duration=round(1000.0 / rate), loop=0)


def _write_mp4(encoder: Any, path: Path, pictures: Iterator[Picture], fps: float) -> None:
    """Write an MP4; an odd side gets one more line of background, since sides must be even. Raises RunFailed.

    The encoder's process may fail after it has taken the last picture, as on a full disk, and imageio-ffmpeg does not
    look at its exit code: so the file itself is looked at.
    """
    pictures = map(_even, pictures)
    first = next(pictures)
    size = first.shape[1], first.shape[0]
    sink = encoder.write_frames(str(path), size, fps=fps, macro_block_size=2, ffmpeg_log_level="error")
    try:
        sink.send(None)
        for picture in chain([first], pictures):
            sink.send(np.ascontiguousarray(picture))
    except (OSError, RuntimeError) as error:
        raise RunFailed(f"the MP4 encoder failed: {str(error).strip().splitlines()[-1]}") from None
    finally:
        sink.close()
    if not _is_whole_mp4(path):
        raise RunFailed("the MP4 encoder did not finish its file: is the disk full?")


def _is_whole_mp4(path: Path) -> bool:
    """Return whether a file's boxes, each a length and a name of four bytes, end where it ends, `moov` among them.

    Counting its pictures by ffmpeg takes a process, and does not see that the last bytes are missing.
    """
    end, names = 0, set[bytes]()
    with path.open("rb") as stream:
        while len(head := stream.read(16)) >= 8:
            length = int.from_bytes(head[8:16] if head[:4] == b"\0\0\0\1" else head[:4])
            if length < 8:
                return False
            end += length
            names.add(head[4:8])
            stream.seek(end)
    return b"moov" in names and end == path.stat().st_size


def _even(picture: Picture) -> Picture:
    height, width = picture.shape[:2]
    return np.pad(picture, ((0, height % 2), (0, width % 2), (0, 0)), constant_values=PAPER[0])
