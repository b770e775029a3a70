"""Pictures of where engines end, all by our renderer and from one place."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from nuno import registry
from nuno.collision.surfaces import surface
from nuno.exports.camera import place_camera, z_up
from nuno.exports.cloth import ShownPiece
from nuno.exports.paint import BODY, INSET, STRETCH, paint_stretch
from nuno.exports.pictures import RENDERER, ROOM
from nuno_bench.gallery.kind import embed
from nuno_bench.peers.skirt.problem import Skirt
from nuno_bench.report.page import Image, Pictures
from nuno_schemas.colour import parse_hex
from nuno_schemas.drawing import Mesh
from nuno_schemas.fabric import Float
from nuno_schemas.view import View

SIZE = (480, 480)
LEGEND = {"label": "stretch (log scale)", "low": STRETCH[0], "high": STRETCH[1], "format": "percent"}


def draw(skirt: Skirt, ends: Mapping[str, Float]) -> Pictures:
    """Places (n, 3) [m] at the end by what they are, the first of which the camera is fitted to."""
    renderer = registry.load("nuno.renderers", RENDERER)
    pairs = skirt.pairs.astype(np.int32)
    piece = ShownPiece("skirt", 0, len(skirt.mass), skirt.faces, pairs, skirt.rest, None, None, None)
    shape = surface(skirt.geometry, INSET)
    points = shape.at(skirt.poses[-1])
    body = _up(Mesh(points, shape.faces, np.tile(parse_hex(BODY), (len(points), 1)), two_sided=False))
    cloths = {name: _up(Mesh(x, piece.faces, paint_stretch(piece.stretch(x)))) for name, x in ends.items()}
    camera = place_camera(View(), list(cloths.values())[:1], SIZE, ROOM)
    images = []
    for name, cloth in cloths.items():
        config = renderer.Config.model_validate({"legend": LEGEND, "ground": float(body.vertices[:, 2].min())})
        images.append(Image(embed(renderer.render(config, [cloth, body], camera)), name))
    return Pictures(images)


def _up(mesh: Mesh) -> Mesh:
    return replace(mesh, vertices=z_up(mesh.vertices))
