"""Make pictures of cloth in docs/pictures by paths of light: python docs/make_pictures.py [NAME ...]

Scenes are run into recordings/pictures/, and not again where a recording of them is there. Needs nuno[paths]; a picture
takes one or two minutes on two cores.
"""

from __future__ import annotations

import os
import shlex
import sys
from pathlib import Path

from PIL import Image

from nuno.cli import main

FOLDER = Path(__file__).resolve().with_name("pictures")
RECORDINGS = FOLDER.parents[1] / "recordings" / "pictures"
MOST_BYTES = 250_000
STOCKING = "--set view.yarns.radius=0.2mm --set view.yarns.colour=#2a1d18"
PICTURES = {
    "skirt-hula-paths": ("skirt-hula", "--frame 300"),
    "sewn-dress": ("sewn/dress", ""),
    "sewn-outfit": ("sewn/outfit", "--size 700x900"),
    "knit-stocking-paths": ("knit/stocking-150", f"{STOCKING} --size 560x840 --samples 256"),
    "knit-stocking-close-paths": (
        "knit/stocking-150",
        f"{STOCKING} --size 700x500 --set view.target=[0,0.33,0.03] --set view.distance=0.16",
    ),
    "skirt-dyed": ("skirt-dyed", ""),
    "contact-two-garments": ("contact/two-garments", ""),
    "contact-knot": ("contact/knot", "--size 640x480 --set view.distance=0.3"),
    "towel": ("towel", "--frame 118 --side close --size 800x600"),
    "sewn-top-wrinkles": ("sewn/top-wrinkles", ""),
    "sewn-top": ("sewn/top", ""),
    "sewn-dress-walk": ("sewn/dress-walk", "--size 700x900"),
    "drape-over-sphere": ("drape-over-sphere", ""),
    "circle-skirt": ("circle-skirt", "--size 640x480 --side close"),
    "skirt-walk": ("skirt-walk", ""),
}
"""Scene and settings of `nuno export` by the picture's name."""


def make(name: str) -> None:
    """Draw a picture, of at most MOST_BYTES: with 256 colours where it would be larger."""
    scene, settings = PICTURES[name]
    recording, picture = RECORDINGS / f"{scene.replace('/', '-')}.mcap", FOLDER / f"{name}.png"
    if not recording.is_file() and main(["run", scene, "--record", str(recording), "--no-view"]):
        raise SystemExit(f"{scene} did not run")
    drawn = f"--renderer paths {'' if '--samples' in settings else '--samples 64'} {settings}"
    if main(["export", str(recording), "--png", str(picture), *shlex.split(drawn)]):
        raise SystemExit(f"{name} could not be drawn")
    with Image.open(picture) as found:
        image = found.convert("RGB")
    image.save(picture, optimize=True)
    if picture.stat().st_size > MOST_BYTES:
        image.quantize(256).save(picture, optimize=True)
    print(f"{name}: {picture.stat().st_size} bytes", flush=True)


if __name__ == "__main__":
    RECORDINGS.mkdir(parents=True, exist_ok=True)
    os.chdir(FOLDER.parents[1])
    for each in sys.argv[1:] or PICTURES:
        make(each)
