"""Make cards.yaml, a deck of 52 cards turned into a spiral: python scenes/contact/make_cards.py

`--resolution 12 15` writes the published size instead, 9,360 vertices.
"""

from __future__ import annotations

import argparse
from pathlib import Path

PATH = Path(__file__).with_name("cards.yaml")
NUMBER, TURN, GAP = 52, 7.0, 0.003
"""Cards, the angle [deg] and the height [m] from one to the next."""
FABRIC = "{density: 300 g/m^2, warp: 1500 N/m, weft: 1500 N/m, shear: 300 N/m, bend_warp: 2 mN*m, bend_weft: 2 mN*m}"
COLOURS = ("#b3202c", "#f3efe6")
HEAD = """\
# Made by make_cards.py, which also makes the published size.
nuno: 1
name: cards
description: A deck of 52 cards, each turned against the one below, falls on a table and stays as it lies.
duration: 2.5 s
until: rest
frame_rate: 60 Hz
solver: {plugin: respa, dt: auto}
damping: 6
cloth_contact: {plugin: offset, thickness: 1 mm, friction: 0.3}
bodies:
  - name: table
    collider: {plugin: plane}
    friction: 0.5
view: {azimuth: 30 deg, elevation: 25 deg}
objects:
"""
CARD = """\
  - name: card-{number}
    colour: "{colour}"
    model:
      plugin: sheet
      size: [63 mm, 88 mm]
      resolution: [{columns}, {rows}]
      plane: xz
      centre: [0, {height:.4g}, 0]
      rotate: {{angle: {angle:g} deg}}
      fabric: {fabric}
"""


def make_cards(columns: int, rows: int) -> str:
    """The scene, of cards with so many vertices across and down."""
    size = {"columns": columns, "rows": rows}
    cards = [
        CARD.format(number=i + 1, colour=COLOURS[i % 2], height=0.004 + GAP * i, angle=TURN * i, fabric=FABRIC, **size)
        for i in range(NUMBER)
    ]
    return HEAD + "".join(cards)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="Make the scene of a deck of cards.")
    parser.add_argument("--resolution", nargs=2, type=int, default=(6, 8), metavar=("ACROSS", "DOWN"))
    PATH.write_text(make_cards(*parser.parse_args().resolution), encoding="utf-8")
