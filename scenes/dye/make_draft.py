"""Make draft.wif, a rosepath on four shafts, and stencil.png, a chrysanthemum: python scenes/dye/make_draft.py"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image

FOLDER = Path(__file__).parent
THREADING = (1, 2, 3, 4, 1, 4, 3, 2)
TREADLING = (1, 2, 3, 4, 1, 4, 3, 2)
TIE_UP = ((1, 2), (2, 3), (3, 4), (1, 4))
SIDE, PETALS = 512, 16


def write_draft(path: Path) -> None:
    """A straight draw that turns back, in 2/2 twill."""
    head = "[WIF]\nVersion=1.1\nDate=April 20, 1997\nDevelopers=wif@mhsoft.com\nSource Program=nuno\n"
    sections = {
        "CONTENTS": ["TEXT=yes", "WEAVING=yes", "WARP=yes", "WEFT=yes", "THREADING=yes", "TIEUP=yes", "TREADLING=yes"],
        "TEXT": ["Title=Rosepath"],
        "WEAVING": ["Shafts=4", "Treadles=4", "Rising Shed=yes"],
        "WARP": [f"Threads={len(THREADING)}", "Units=Centimeters", "Spacing=0.05", "Thickness=0.04"],
        "WEFT": [f"Threads={len(TREADLING)}", "Units=Centimeters", "Spacing=0.05", "Thickness=0.04"],
        "TIEUP": [f"{i}={','.join(map(str, shafts))}" for i, shafts in enumerate(TIE_UP, 1)],
        "THREADING": [f"{i}={shaft}" for i, shaft in enumerate(THREADING, 1)],
        "TREADLING": [f"{i}={treadle}" for i, treadle in enumerate(TREADLING, 1)],
    }
    body = (f"\n[{name}]\n" + "".join(f"{line}\n" for line in lines) for name, lines in sections.items())
    path.write_text(head + "".join(body), encoding="ascii")


def draw_stencil() -> Image.Image:
    """White petals around a white middle."""
    y, x = (np.mgrid[0:SIDE, 0:SIDE] + 0.5) / SIDE * 2.0 - 1.0
    r, turn = np.hypot(x, y), np.arctan2(y, x) * PETALS / (2.0 * np.pi)
    away = np.abs(turn - np.round(turn)) * 2.0 * np.pi / PETALS * r
    petal = (r > 0.2) & (r < 0.62) & (away < 0.42 * 2.0 * np.pi / PETALS * r)
    tip = (r >= 0.62) & (np.hypot(away, r - 0.62) < 0.42 * 2.0 * np.pi / PETALS * 0.62)
    return Image.fromarray(petal | tip | (r < 0.14))


if __name__ == "__main__":
    write_draft(FOLDER / "draft.wif")
    draw_stencil().save(FOLDER / "stencil.png", optimize=True)
