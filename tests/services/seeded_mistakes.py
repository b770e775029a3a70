"""Mistakes that people make in scenes: of many kinds, in many shipped scenes, drawn from a seed."""

from __future__ import annotations

import random
import shutil
from collections.abc import Callable, Iterator
from copy import deepcopy
from pathlib import Path
from typing import Any, NamedTuple

import yaml

from nuno.scene import shipped, yaml_lines
from nuno.scene.override import item_at
from nuno.scene.yaml_lines import dotted

Place = yaml_lines.Path
SEED = 20
NUMBER = 50
PRESETS = ("fabric", "yarns", "dyes")
REFERENCES = ("body", "object")


class Mistake(NamedTuple):
    """A scene that was right but for one thing: its kind, the shipped scene, where the mistake is, and the text."""

    kind: str
    scene: str
    place: str
    text: str


def places(data: Any, path: Place = ()) -> Iterator[tuple[Place, Any]]:
    """All that stands in a scene, and where."""
    if path:
        yield path, data
    pairs = data.items() if isinstance(data, dict) else enumerate(data) if isinstance(data, list) else ()
    for key, value in pairs:
        yield from places(value, (*path, key))


def _is_quantity(value: Any) -> bool:
    return isinstance(value, str) and value[:1].isdigit() and " " in value


def _swap(word: str) -> str:
    """As fingers do: two letters change their places; a letter alone comes twice."""
    for i in range(len(word) - 1):
        if word[i] != word[i + 1]:
            return word[:i] + word[i + 1] + word[i] + word[i + 2 :]
    return word * 2


def _of(key: str | tuple[str, ...], kind: Callable[[Any], bool]) -> Callable[[Place, Any], bool]:
    keys = (key,) if isinstance(key, str) else key
    return lambda path, value: path[-1] in keys and kind(value)


def _is_text(value: Any) -> bool:
    return isinstance(value, str)


def _is_list(value: Any) -> bool:
    return isinstance(value, list) and len(value) > 1 and all(isinstance(one, int | float | str) for one in value)


Changed = Callable[[random.Random, Any], Any]
LIMITED = "friction", "duration", "frame_rate", "thickness", "gap", "resolution", "edge", "seed"
CHANGES: dict[str, tuple[Callable[[Place, Any], bool], Changed]] = {
    "unit": (lambda path, value: _is_quantity(value), lambda rng, value: value.split()[0] + rng.choice([" kg", " K"])),
    "no unit at all": (lambda path, value: _is_quantity(value), lambda rng, value: f"{value.split()[0]} parsnips"),
    "limit": (_of(LIMITED, lambda value: True), lambda rng, value: -3),
    "type": (
        lambda path, value: isinstance(value, int | float | bool) and path != ("nuno",),
        lambda rng, value: rng.choice([{"a": 1}, "many", [[]]]),
    ),
    "mapping": (lambda path, value: isinstance(value, dict) and len(value) > 2, lambda rng, value: 7),
    "plugin": (_of("plugin", _is_text), lambda rng, value: _swap(value)),
    "preset": (_of(PRESETS, _is_text), lambda rng, value: _swap(value)),
    "choice": (_of(("until", "kind", "shape", "form", "end", "plane"), _is_text), lambda rng, value: _swap(value)),
    "file": (_of(("file", "texture"), _is_text), lambda rng, value: f"not-{value}"),
    "body": (_of(REFERENCES, _is_text), lambda rng, value: _swap(value)),
    "bodies": (lambda path, value: path[:2] == ("cloth_contact", "bodies") and _is_text(value),
               lambda rng, value: _swap(value)),
    "length of a list": (lambda path, value: _is_list(value) and path[-1] in ("size", "resolution", "centre", "cells"),
                         lambda rng, value: value[:1]),
}  # fmt: skip
"""By kind: where such a mistake can be made, and what is written there instead."""


def make(kind: str, scene: str, rng: random.Random) -> Mistake | None:
    """A mistake in a scene; None where it has no place for one of this kind."""
    data = yaml_lines.parse(shipped.find(scene).read_text(encoding="utf-8"), scene)[0]
    every = list(places(data))
    mappings = [((), data), *((path, value) for path, value in every if isinstance(value, dict))]
    if kind == "field":
        path, inside = rng.choice(mappings)
        key = rng.choice([key for key in inside if key not in ("plugin", "nuno")] or [None])
        if key is None:
            return None
        renamed = {(_swap(str(name)) if name == key else name): value for name, value in inside.items()}
        return Mistake(kind, scene, dotted((*path, _swap(str(key)))), _dump(_put(data, path, renamed)))
    if kind == "missing":
        needed = [path for path, _ in every if path[-1] in ("model", "collider", "plugin") and len(path) > 1]
        path = rng.choice([(key,) for key in ("name", "duration") if key in data] + needed)
        inside = item_at(data, path[:-1]) if len(path) > 1 else data
        kept = {key: value for key, value in inside.items() if key != path[-1]}
        return Mistake(kind, scene, dotted(path), _dump(_put(data, path[:-1], kept)))
    if kind == "name twice":
        list_ = rng.choice([one for one in ("objects", "bodies") if data.get(one)] or [None])
        if list_ is None:
            return None
        return Mistake(kind, scene, list_, _dump(data | {list_: [*data[list_], data[list_][0]]}))
    if kind == "yaml":
        lines = _dump(data).splitlines(keepends=True)
        at = rng.randrange(1, len(lines))
        lines[at] = rng.choice(["name: [\n", "\tname: x\n", "name: 'x\n", "name: x: y\n", "nuno: 1\n"])
        return Mistake(kind, scene, f"line {at + 1}", "".join(lines))
    fits, change = CHANGES[kind]
    found = [path for path, value in every if fits(path, value)]
    if not found:
        return None
    path = rng.choice(found)
    return Mistake(kind, scene, dotted(path), _dump(_put(data, path, change(rng, item_at(data, path)))))


def _put(data: Any, path: Place, value: Any) -> Any:
    if not path:
        return value
    found = deepcopy(data)
    inside = item_at(found, path[:-1]) if len(path) > 1 else found
    inside[path[-1]] = value
    return found


def _dump(data: Any) -> str:
    # Without anchors: what is written twice stands there twice.
    return yaml.safe_dump(deepcopy(data), sort_keys=False, allow_unicode=True, width=110)


def draw(seed: int = SEED, number: int = NUMBER) -> list[Mistake]:
    """As many mistakes, all kinds in turn, each in another scene than the one before."""
    rng = random.Random(seed)
    kinds = ["field", "missing", "name twice", "yaml", *CHANGES]
    names = [name for name in shipped.scenes() if not name.startswith("extreme/")]
    found: list[Mistake] = []
    for i in range(number):
        while (made := make(kinds[i % len(kinds)], rng.choice(names), rng)) is None:
            pass
        found.append(made)
    return found


def write(mistakes: list[Mistake], folder: Path) -> list[Path]:
    """A file for each, in a folder with the files that shipped scenes name."""
    for place in ("", *shipped.FOLDERS):
        for path in (shipped.folder() / place).glob("*"):
            if path.suffix in (".obj", ".npz", ".bvh", ".png", ".jpg", ".wif"):
                shutil.copyfile(path, folder / path.name)
    shutil.copytree(shipped.folder() / "sewn" / "patterns", folder / "patterns")
    paths = [folder / f"scene-{i}.yaml" for i in range(len(mistakes))]
    for path, mistake in zip(paths, mistakes, strict=True):
        path.write_text(mistake.text, encoding="utf-8")
    return paths
