"""Make the pictures of rerun's viewer in docs/pictures: python docs/make_viewer_pictures.py SOFT.mcap DAMPED.mcap

The recordings are those of docs/how-to/viewing.md, `nuno run skirt-hula` and the same with `--set damping=3`. rerun
draws without a screen where there is a Vulkan driver, in software too (Debian: mesa-vulkan-drivers).
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

FOLDER, SIZE, AT, SOON = Path(__file__).with_name("pictures"), (1200, 675), 4.5, 60.0


def look(path: Path, name: str) -> None:
    """Keep a picture of the whole window at AT [s], once two in a row are equal."""
    binary, end, previous = os.path.join(rerun_cli.__path__[0], "rerun"), time.monotonic() + SOON, b""
    with ViewerClient.spawn(headless=True, port=free_port(), executable_path=binary) as client:
        client.open(str(path))
        while not client.get_state().views and time.monotonic() < end:
            time.sleep(0.2)
        client.set_time("sim_time", duration=AT, play_state="paused")
        time.sleep(3.0)
        while (png := client.take_screenshot()) != previous and time.monotonic() < end:
            previous = png
            time.sleep(0.5)
    picture = Image.open(io.BytesIO(png)).convert("RGB").resize(SIZE, Image.Resampling.LANCZOS)
    picture.save(FOLDER / f"{name}.png", optimize=True)


with tempfile.TemporaryDirectory(prefix="nuno-") as folder:
    both, one = Path(folder) / "both.rrd", Path(folder) / "one.rrd"
    assert main(["view", *sys.argv[1:3], "--save", str(both)]) == 0
    assert main(["view", sys.argv[1], "--colour", "stretch", "--save", str(one)]) == 0
    look(both, "viewer-comparison")
    look(one, "viewer-stretch")
