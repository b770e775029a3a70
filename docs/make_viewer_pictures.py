"""Make the pictures of rerun's viewer in docs/pictures: python docs/make_viewer_pictures.py [NAME ...]

Scenes are run into recordings/pictures/, and not again where a recording of them is there. rerun draws without a screen
where there is a Vulkan driver, in software too (Debian: mesa-vulkan-drivers).
"""

from __future__ import annotations

import io
import os
import sys
import tempfile
import time
from pathlib import Path

import rerun_cli
from PIL import Image
from rerun.experimental import ViewerClient

from nuno.bus.sessions import free_port
from nuno.cli import main

FOLDER, SIZE, SOON = Path(__file__).resolve().with_name("pictures"), (1200, 675), 60.0
RECORDINGS = FOLDER.parents[1] / "recordings" / "pictures"
RUNS = {
    "soft": "skirt-hula",
    "damped": "skirt-hula --set damping=3",
    "layers": "contact/two-garments",
    "drops": "dye/drops",
    "knit": "knit/stitch-10x10",
}
"""Arguments of `nuno run` by the recording's name."""
SCREENS: dict[str, tuple[str, str, float]] = {
    "viewer-comparison": ("soft damped", "", 4.5),
    "viewer-over": ("soft damped", "--over", 4.5),
    "viewer-stretch": ("soft", "--colour stretch", 4.5),
    "viewer-curvature": ("soft", "--colour curvature", 4.5),
    "viewer-nearness": ("layers", "--colour nearness", 0.3),
    "viewer-tension": ("knit", "--colour tension", 1.0),
    "viewer-dye": ("drops", "", 3600.0),
}
"""Recordings, arguments of `nuno view`, and the time that is shown [s], by the picture's name."""


def recorded(name: str) -> str:
    """Return the path of a recording, which is made if it is not there."""
    path = RECORDINGS / f"{name}.mcap"
    if not path.is_file() and main(["run", *RUNS[name].split(), "--record", str(path), "--no-view"]):
        raise SystemExit(f"{name} did not run")
    return str(path)


def look(path: str, name: str, at: float) -> None:
    """Keep a picture of the whole window at a time [s], once two in a row are equal."""
    binary, end, previous = os.path.join(rerun_cli.__path__[0], "rerun"), time.monotonic() + SOON, b""
    with ViewerClient.spawn(headless=True, port=free_port(), executable_path=binary) as client:
        client.open(path)
        while not client.get_state().views and time.monotonic() < end:
            time.sleep(0.2)
        timeline = "dye_time" if "dye" in name else "sim_time"
        client.set_time(timeline, duration=at, play_state="paused")
        time.sleep(3.0)
        while (png := client.take_screenshot()) != previous and time.monotonic() < end:
            previous = png
            time.sleep(0.5)
    picture = Image.open(io.BytesIO(png)).convert("RGB").resize(SIZE, Image.Resampling.LANCZOS)
    if name == "viewer-dye":  # yarns have detail everywhere
        picture = picture.quantize(256)
    picture.save(FOLDER / f"{name}.png", optimize=True)
    print(f"{name}: {(FOLDER / f'{name}.png').stat().st_size} bytes", flush=True)


RECORDINGS.mkdir(parents=True, exist_ok=True)
os.chdir(FOLDER.parents[1])
for screen in sys.argv[1:] or SCREENS:
    names, settings, moment = SCREENS[screen]
    paths = [recorded(name) for name in names.split()]
    with tempfile.TemporaryDirectory(prefix="nuno-") as scratch:
        shown = str(Path(scratch) / "view.rrd")
        assert main(["view", *paths, *settings.split(), "--save", shown]) == 0
        look(shown, screen, moment)
