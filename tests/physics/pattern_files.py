"""Pictures of resists in a folder, as a scene's files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image

from nuno_schemas.fabric import Float

SIZE = 1e-4


class Folder:
    """Files of one folder."""

    def __init__(self, root: Path) -> None:
        self.root = root

    def resolve(self, name: str) -> Path:
        return self.root / name


def write_image(path: Path, values: Float) -> None:
    """Write B (ny, nx) as a grey PNG of 16 bits, which `read_image` reads again within 2^-17."""
    Image.fromarray(np.rint(np.clip(values, 0.0, 1.0) * 65535.0).astype(np.uint16)).save(path, format="PNG")
