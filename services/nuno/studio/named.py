"""What a scene names and is not there, told without building anything, in the words of whoever would build it."""

from __future__ import annotations

import numpy as np

from nuno.cloth.build import drawn_over, frame_of, no_body
from nuno.collision.bodies import build_bodies
from nuno.scene.provenance import texts_in
from nuno.scene.scene_file import Loaded
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Binding

FILES = ("file", "texture")
"""Fields that name a file beside the scene."""


def check_named(loaded: Loaded) -> None:
    """Raises BadInput for a file that is not there, and for cloth on a body that is not."""
    for chosen in loaded.chosen:
        for name in (text for field, text in texts_in(chosen.config.model_dump()) if field in FILES):
            try:
                loaded.files.resolve(name)
            except BadInput as error:
                raise loaded.at(chosen.field, error) from None
    known = [body.name for body in loaded.scene.bodies]
    for i, model in enumerate(loaded.models):
        over, attach = drawn_over(model), getattr(model.config, "attach", None)
        if over is not None and over not in known:
            raise loaded.at(f"objects[{i}].model", no_body(over, known))
        if attach is not None and attach.body not in known:
            # Which frames there are, bodies say: they are read to be told, now that there is a mistake.
            frames = build_bodies(loaded).geometry.frames if known else ()
            try:
                frame_of(Binding(np.zeros(0, np.int32), attach.body, attach.frame), frames)
            except BadInput as error:
                raise loaded.at(f"objects[{i}].model.attach", error) from None
