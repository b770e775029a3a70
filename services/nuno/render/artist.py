"""Drawing of a scene's yarns without a recording, from the scene and its positions."""

from __future__ import annotations

import io
from dataclasses import replace

import numpy as np

from nuno.collision.bodies import build_bodies
from nuno.exports.camera import z_up
from nuno.exports.cloth import shape_bodies
from nuno.exports.yarns import GROUP, STYLE, captioned, find_camera, put_on
from nuno.plugin_contract import registry
from nuno.recording.recorded import Frame
from nuno.scene.chosen_plugins import Chosen
from nuno.scene.scene_file import Loaded
from nuno.simulation.cloth import build_fabric
from nuno_schemas.errors import BadInput
from nuno_schemas.pictures import Camera, Mesh, Worn

TRIAL = (16, 16)
"""Size in pixels of the trial picture, which shows errors before anything starts."""


class Artist:
    """Draws frames of one scene with one camera, which is fitted to the first frame.

    Raises BadInput for a scene without yarns, and for one that its style cannot draw.
    """

    def __init__(self, loaded: Loaded) -> None:
        self.loaded = loaded
        self.chosen = loaded.yarn_picture or _default()
        self.fabric, self.pieces = build_fabric(loaded)
        if self.fabric.yarns is None:
            problem, remedy = "the scene has no yarns to draw", "leave view.pictures out; yarns are what a knit has"
            raise loaded.at("view.pictures", BadInput(problem, remedy=remedy))
        self.bodies = build_bodies(loaded) if loaded.scene.bodies else None
        self.shapes = None
        if self.bodies is not None:
            self.shapes = shape_bodies(self.bodies.geometry, self.bodies.poses(0.0))
        self.camera: Camera | None = None
        start = Frame(0, 0.0, "", np.asarray(self.fabric.position))
        try:
            worn = self.show(start)
            self._picture(worn, start, replace(find_camera(loaded.scene.view, worn, None), size=TRIAL))
        except BadInput as error:
            raise loaded.at("view", error) from None

    def draw(self, frame: Frame) -> bytes:
        """Return a frame's picture as PNG. Raises BadInput for a frame that cannot be drawn."""
        from PIL import Image

        if not np.isfinite(frame.x).all():
            raise BadInput(f"the positions of frame {frame.number} are not finite")
        worn = self.show(frame)
        self.camera = self.camera or find_camera(self.loaded.scene.view, worn, None)
        stream = io.BytesIO()
        Image.fromarray(self._picture(worn, frame, self.camera)).save(stream, format="PNG", optimize=True)
        return stream.getvalue()

    def show(self, frame: Frame) -> Worn:
        """Return yarns, bodies and other cloth of a frame."""
        meshes = []
        if self.bodies is not None and self.shapes is not None and len(self.shapes.vertices):
            at = self.shapes.at(self.bodies.poses(frame.t))
            meshes.append(Mesh(z_up(at), self.shapes.faces, two_sided=False))
        if len(self.fabric.faces):
            meshes.append(Mesh(z_up(frame.x), self.fabric.faces))
        return put_on(self.loaded, self.fabric, frame, self.chosen, meshes)

    def _picture(self, worn: Worn, frame: Frame, camera: Camera) -> np.ndarray:
        colours = [piece.colour for piece in self.pieces if piece.colour]
        config = captioned(self.chosen, self.loaded.scene.name, frame.t, colours)
        picture: np.ndarray = self.chosen.plugin.draw(config, worn, camera)
        return picture


def _default() -> Chosen:
    plugin = registry.load(GROUP, STYLE)
    return Chosen(GROUP, plugin, plugin.Config(), "view.yarns", {})
