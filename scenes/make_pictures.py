"""Make pictures/*.webp, what the studio shows of each scene: python scenes/make_pictures.py [NAME | NAME=PICTURE ...]

Each scene is run, and stopped where it takes more than `--limit` of the processor's time; its last frame is drawn, as
`nuno export --png` does, and made small. Of a scene with a PICTURE that was drawn already, as those of docs/pictures,
that is made small. Without names, those are made that are not there yet.
"""

from __future__ import annotations

import argparse
import contextlib
import signal
import sys
import tempfile
from pathlib import Path

from PIL import Image

import nuno
from nuno.scene import shipped
from nuno_schemas.errors import BadInput, RunFailed

FOLDER = Path(__file__).with_name("pictures")
SIZE = 288, 216
"""Of a picture [pixels]: as large as a card of the studio is on most screens."""
MOST_BYTES = 12_000
CAPTION = 0.05
"""Of a drawn picture's height, at its foot: what stands there is too small to be read."""
LIMIT = 60.0
"""Of the processor's time that a scene takes [s] before it is stopped, unless told otherwise."""


def make_picture(name: str, limit: float) -> Path:
    """Run a scene and keep the picture of its end, or of where it is after `limit` [s] of the processor's time."""
    with tempfile.TemporaryDirectory(prefix="nuno-") as folder:
        recording, drawn = Path(folder) / "run.mcap", Path(folder) / "end.png"
        signal.setitimer(signal.ITIMER_PROF, limit)
        with contextlib.suppress(KeyboardInterrupt):
            nuno.run(name, record=recording, progress=False)
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        nuno.export(recording, png=drawn)
        return keep(drawn, FOLDER / f"{name}.webp")


def keep(drawn: Path, path: Path) -> Path:
    """The middle of a picture in the shape of SIZE, as good as MOST_BYTES allow."""
    with Image.open(drawn) as found:
        picture = found.convert("RGB")
    width, height = SIZE
    foot = picture.height * (1.0 - CAPTION)
    scale = min(picture.width / width, foot / height)
    left, top = 0.5 * (picture.width - scale * width), 0.5 * (foot - scale * height)
    part = left, top, left + scale * width, top + scale * height
    small = picture.resize(SIZE, Image.Resampling.LANCZOS, box=part)
    path.parent.mkdir(parents=True, exist_ok=True)
    for quality in range(80, 10, -10):
        small.save(path, quality=quality, method=6)
        if path.stat().st_size <= MOST_BYTES:
            break
    return path


def main() -> int:
    parser = argparse.ArgumentParser(description="Pictures of scenes, for the studio.")
    parser.add_argument(
        "names", nargs="*", metavar="NAME[=PICTURE]", help="of scenes (default: those without a picture)"
    )
    parser.add_argument("--limit", type=float, default=LIMIT, metavar="SECONDS", help="of the processor's time")
    args = parser.parse_args()
    signal.signal(signal.SIGPROF, signal.default_int_handler)
    failed = []
    missing = [name for name in shipped.scenes() if not (FOLDER / f"{name}.webp").is_file()]
    for given in args.names or missing:
        name, _, drawn = given.partition("=")
        try:
            path = keep(Path(drawn), FOLDER / f"{name}.webp") if drawn else make_picture(name, args.limit)
            print(f"{name}: {path.stat().st_size} bytes", flush=True)
        except (BadInput, RunFailed, OSError) as error:
            failed.append(name)
            print(f"{name}: {error}", flush=True)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
