"""Make plain-warp.png and plain-weft.png, masks of an even plain weave: python scenes/dye/make_masks.py

They are of photograph.jpg's size, and do not fit its yarns, which are not even: figure 14 (left) of the dye paper
shows what a picture is like whose yarns are not those that dye spreads in.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image

WIDTH, HEIGHT, YARN = 640, 480, 12

y, x = np.mgrid[0:HEIGHT, 0:WIDTH] // YARN
warp = (x + y) % 2 == 0
for name, mask in (("warp", warp), ("weft", ~warp)):
    Image.fromarray(mask).save(Path(__file__).with_name(f"plain-{name}.png"), optimize=True)
