"""Operations on cloth during its simulation: their text, and the transfer of solver memory and checkpoints."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nuno.bus.encodings import arrays_of
from nuno.plugin_contract import registry
from nuno.scene import yaml_lines
from nuno.scene.chosen_plugins import Chosen, choose_operation
from nuno.scene.files import SceneFiles
from nuno.scene.scene_file import Loaded
from nuno.scene.validation_errors import UNNUMBERED, validated
from nuno_schemas.errors import BadInput, nearest
from nuno_schemas.fabric import Binding, Fabric, Hinges, Int, Relief
from nuno_schemas.operation import arranges
from nuno_schemas.scene import Applied

NAME = "add"
"""Name of an added operation's text in errors."""
ARRAYS = ("position", "velocity", "mass", "pinned", "faces", "uv")
PARTS = ("springs", "hinges", "membrane", "bending", "friction", "corners", "relief")
"""Parts of a fabric that hold arrays; any may be None."""
ADDED = {"hinges": Hinges, "relief": Relief}
"""Parts that operations give a fabric without them."""


def name_of(item: str) -> str:
    """Return `wrinkle` for `wrinkle: {lines: [...]}`; "" for a text that is no mapping of one name."""
    value = yaml_lines.parse_value(item)
    return str(next(iter(value))) if isinstance(value, dict) and len(value) == 1 else ""


def parse(item: str, loaded: Loaded) -> tuple[int, Chosen, str]:
    """Return the object's number, the operation, and the text with the content of its files in place of their names.

    Raises BadInput.
    """
    name, installed_names = name_of(item), sorted(registry.installed("nuno.operations"))
    if name not in installed_names:
        remedy = "for example wrinkle: {lines: [{points: [[0, 0, 0], [0.1, 0, 0]], height: 1 cm}]}"
        problem, limit = "cloth that moves is changed by an operation", nearest(name, installed_names)
        raise BadInput(problem, NAME, value=item, limit=limit, remedy=remedy)
    fields = yaml_lines.parse_value(item)[name]
    if not isinstance(fields, dict):
        raise BadInput("an operation is given by a mapping of fields", NAME, value=item)
    if "at" in fields:
        raise BadInput("what is added is applied at once", NAME, field="at", remedy="leave it out")
    data = {"plugin": name, **fields}
    lines = dict.fromkeys((place for place, _ in yaml_lines.walk(data)), UNNUMBERED)
    applied = validated(Applied, data, NAME, lines)
    names = [spec.name for spec in loaded.scene.objects]
    object_name = applied.object or (names[0] if len(names) == 1 else "")
    if object_name not in names:
        remedy = nearest(object_name, names)
        raise BadInput("say which object it changes", NAME, field="object", value=applied.object, remedy=remedy)
    files = SceneFiles(loaded.files.folder, loaded.files.roots)
    chosen = choose_operation(applied, (), NAME, lines, files)
    if arranges(chosen.plugin):
        raise BadInput("this operation is for the start, before the first frame", NAME, value=name,
                       remedy=f"run the scene again with operations: [{{plugin: {name}}}]")  # fmt: skip
    if files.used:
        target = {} if applied.object is None else {"object": applied.object}
        fields_given = chosen.config.model_dump(mode="json", exclude_none=True, exclude_defaults=True)
        item = json.dumps({chosen.name: target | fields_given})
    return names.index(object_name), chosen, item


def carry(values: NDArray[Any], target: NDArray[Any], source: Int) -> NDArray[Any]:
    """Return a solver's array for a changed fabric: old vertices keep `values`, new ones have those of `target`.

    source (n,) is the former number of each vertex, -1 for a new one. An array of the same shape is returned unchanged;
    one whose size is not that of the vertices, such as a list of near pairs, is `target`.
    """
    axes = [i for i, (old, new) in enumerate(zip(values.shape, target.shape, strict=True)) if old != new]
    if not axes:
        return values
    if target.shape[axes[0]] != len(source):
        return target
    carried = np.moveaxis(target.copy(), axes[0], 0)
    old = source >= 0
    carried[old] = np.moveaxis(values, axes[0], 0)[source[old]]
    return np.ascontiguousarray(np.moveaxis(carried, 0, axes[0]))


def fabric_arrays(fabric: Fabric) -> dict[str, NDArray[Any]]:
    """Return all arrays of a fabric without yarns, for a checkpoint; `fabric_from` is the inverse."""
    arrays = {name: getattr(fabric, name) for name in ARRAYS if getattr(fabric, name) is not None}
    for part in PARTS:
        if (values := getattr(fabric, part)) is not None:
            arrays |= arrays_of(values, f"{part}.")
    for i, binding in enumerate(fabric.bindings):
        arrays[f"bindings.{i}"] = binding.vertices
        arrays |= {} if binding.local is None else {f"bindings.{i}.local": binding.local}
    return arrays


def frames_bound(fabric: Fabric) -> list[tuple[str, str | None]]:
    """Return body and frame of each binding of a fabric, for a checkpoint."""
    return [(binding.body, binding.frame) for binding in fabric.bindings]


def fabric_from(
    arrays: dict[str, NDArray[Any]], built: Fabric, origin: dict[str, float], bound: Sequence[tuple[str, str | None]]
) -> Fabric:
    """Return the fabric of a checkpoint; `built` is that of the scene, and `bound` is its former `frames_bound`.
    Raises BadInput where it is damaged.
    """
    try:
        parts: dict[str, Any] = {name: arrays[name] for name in ARRAYS if name in arrays}
        for part in PARTS:  # panels stay as they are cut: no operation changes triangles of corners
            values = {name.partition(".")[2]: a for name, a in arrays.items() if name.startswith(f"{part}.")}
            if (built_part := getattr(built, part)) is not None:
                parts[part] = replace(built_part, **{name: values[name] for name in arrays_of(built_part)})
            elif part in ADDED and values:
                parts[part] = ADDED[part](**values)
        bindings = tuple(
            Binding(arrays[f"bindings.{i}"].astype(np.int32), body, frame, arrays.get(f"bindings.{i}.local"))
            for i, (body, frame) in enumerate(bound)
        )
    except KeyError as error:
        raise BadInput(f"the checkpoint lacks {error} of a changed fabric") from None
    return replace(built, **parts, bindings=bindings, origin=origin)
