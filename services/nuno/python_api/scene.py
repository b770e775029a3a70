"""Scenes as objects, and as arguments of calls, whose errors name the arguments."""

from __future__ import annotations

import contextlib
import json
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from copy import deepcopy
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import yaml

from nuno.process import scratch
from nuno.scene import scene_file, shipped, yaml_lines
from nuno.scene.override import as_override, item_at, number_or_name, parts_of
from nuno.scene.scene_file import Loaded
from nuno_schemas.errors import BadInput, nearest
from nuno_schemas.scene import Scene as Fields

GIVEN = "the scene given"
"""Name of a scene that is a mapping, in errors."""
Folder = str | os.PathLike[str]


class Given(NamedTuple):
    """Sources of a scene: its file or mapping, overrides as texts, folders of its files."""

    source: Path | Mapping[str, Any]
    texts: tuple[str, ...]
    roots: tuple[Path, ...]


class Scene:
    """A checked, immutable scene; `copy` returns a changed one. A scene of a file is read again from there when it is
    run.

    Its fields are attributes, in SI units and with their defaults: scene.duration, scene.solver.plugin. Fields as
    written are items: scene["solver.dt"], scene["objects.0.model"]; and `str` returns the whole as YAML.
    """

    def __init__(
        self,
        scene: Folder | Mapping[str, Any] | Scene,
        *overrides: str | Mapping[str, Any],
        roots: Sequence[Folder] = (),
        **fields: Any,
    ) -> None:
        """scene: a file, the name of a shipped scene, a mapping of its fields, or another scene; `overrides`, `fields`
        and `roots` as in `nuno.run`. Raises BadInput.
        """
        with in_python():
            source = _add(scene, as_texts([*overrides, fields]), roots)
            if isinstance(source.source, Path):  # the working folder may change later
                folders = tuple(root.absolute() for root in source.roots)
                source = source._replace(source=source.source.absolute(), roots=folders)
            self._source = source
            with loaded(self) as scene_loaded:
                self._data, self._fields = scene_loaded.data, scene_loaded.scene

    def __setattr__(self, name: str, value: object) -> None:
        if not name.startswith("_"):
            raise AttributeError(f"a scene stays as it is: make another, scene.copy({name}=...)")
        super().__setattr__(name, value)

    def copy(self, *overrides: str | Mapping[str, Any], **fields: Any) -> Scene:
        """Return a scene changed by `overrides` and `fields` as in `nuno.run`. Raises BadInput."""
        return Scene(self, *overrides, **fields)

    @property
    def fields(self) -> Fields:
        """All fields of the scene, in SI units."""
        return self._fields

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_") or name not in Fields.model_fields:
            raise AttributeError(f"a scene has no field {name!r}")
        return getattr(self._fields, name)

    def __dir__(self) -> list[str]:
        return sorted({*super().__dir__(), *Fields.model_fields})

    def __getitem__(self, key: str) -> Any:
        """Return the written value at a.b.0.c. Raises KeyError if there is none."""
        value = item_at(self._data, tuple(number_or_name(part) for part in parts_of(key)))
        if value is None:
            keys = self._ipython_key_completions_()
            raise KeyError(f"{key} is not written in the scene; {nearest(key, keys)}")
        return deepcopy(value)

    def __contains__(self, key: object) -> bool:
        """Return whether the scene has a written value at this key."""
        return isinstance(key, str) and item_at(self._data, tuple(map(number_or_name, parts_of(key)))) is not None

    def __iter__(self) -> Iterator[str]:
        """Iterate over the names of the written fields."""
        return iter(self._data)

    def _ipython_key_completions_(self) -> list[str]:
        return [".".join(map(str, place)) for place, _ in yaml_lines.walk(self._data) if place]

    def __str__(self) -> str:
        return str(yaml.safe_dump(self._data, sort_keys=False, allow_unicode=True, width=100))

    def __repr__(self) -> str:
        source = "a mapping" if isinstance(self._source.source, Mapping) else os.fspath(self._source.source)
        changed = f", changed by {', '.join(self._source.texts)}" if self._source.texts else ""
        return f"<Scene {self._fields.name}: {source}{changed}>"


def as_texts(overrides: Sequence[object]) -> list[str]:
    """Return overrides as they are written after --set. Raises BadInput for an override that is neither text nor a
    mapping, or has a value that no scene can have.
    """
    texts = list[str]()
    for item in overrides:
        if isinstance(item, str):
            texts.append(item)
            continue
        if not isinstance(item, Mapping):
            remedy = 'give each after the scene: nuno.run("hanging-sheet", "duration=1", {"solver.plugin": "rk4"})'
            problem, limit = "an override is neither text nor a mapping", '"key=value", or a mapping of keys to values'
            raise BadInput(problem, "overrides", value=item, limit=limit, remedy=remedy)
        for key, value in item.items():
            try:
                texts.append(as_override(key, value.tolist() if isinstance(value, np.generic | np.ndarray) else value))
            except yaml.YAMLError:
                problem, remedy = "holds what a scene cannot say", "use numbers, text, lists and mappings"
                raise BadInput(problem, "overrides", field=str(key), value=value, remedy=remedy) from None
    return texts


def _add(scene: object, texts: Sequence[str], roots: Sequence[Folder]) -> Given:
    if isinstance(scene, Mapping):
        return Given(deepcopy(scene), tuple(texts), (Path.cwd(), *(Path(root).absolute() for root in roots)))
    if isinstance(scene, str | os.PathLike):
        return Given(shipped.find(os.fspath(scene)), tuple(texts), tuple(map(Path, roots)))
    if not isinstance(scene, Scene):
        limit = "a file, the name of a shipped scene, a mapping of its fields, or a Scene"
        raise BadInput("this is no scene", field="scene", value=scene, limit=limit)
    previous = scene._source
    return Given(previous.source, (*previous.texts, *texts), (*previous.roots, *map(Path, roots)))


@contextlib.contextmanager
def loaded(
    scene: Folder | Mapping[str, Any] | Scene, overrides: Sequence[str] = (), roots: Sequence[Folder] = ()
) -> Iterator[Loaded]:
    """Load a scene, which other processes can read inside the context. Raises BadInput."""
    source = _add(scene, overrides, roots)
    if not isinstance(source.source, Mapping):
        yield scene_file.read(source.source, source.texts, source.roots)
        return
    try:
        text = json.dumps(dict(source.source))
    except (TypeError, ValueError) as error:
        remedy = "use numbers, text, lists and mappings"
        raise BadInput(f"holds what a scene cannot say: {error}", GIVEN, remedy=remedy) from None
    with scratch() as folder:
        path = folder / "scene.yaml"
        path.write_text(text)
        yield scene_file.read(path, source.texts, source.roots, GIVEN)


# Errors in terms of a call's arguments, in place of the command line's flags.

RENAMED = {"set": "overrides", "root": "roots"}
OTHERS = ("dask", "jobs", "out", "over", "record", "resume", "root", "set", "threads")
"""Flags that are arguments of a call, besides those of `nuno export`, with the same name unless RENAMED."""


@cache
def _flag() -> re.Pattern[str]:
    """Return the pattern of a flag, with its value in an example."""
    from nuno.python_api.export import ExportRequest

    names = "|".join([*ExportRequest.model_fields, *OTHERS])
    return re.compile(rf"(?<![^\s('\"])--({names})\b(?: (DIR|FILE\b|\S+=\S+|[A-Za-z0-9_]+\.[a-z0-9]+))?")


@contextlib.contextmanager
def in_python() -> Iterator[None]:
    """Raise BadInput from inside in terms of the call's own arguments."""
    try:
        yield
    except BadInput as error:
        raise _translated(error) from None


def _translated(error: BadInput) -> BadInput:
    texts = {name: getattr(error, name) for name in ("problem", "field", "limit", "remedy")}
    if error.file is not None and error.file.startswith("--"):  # a flag's value
        texts["file"] = error.file
    changed: dict[str, Any] = {name: _flag().sub(_argument, text) for name, text in texts.items() if text is not None}
    if error.field is not None:
        changed["field"] = changed["field"].removeprefix("--")
    return replace(error, **changed)


def _argument(match: re.Match[str]) -> str:
    name, value_text = RENAMED.get(match[1], match[1]), match[2]
    if value_text is None:
        return name
    if match[1] == "set":
        return f'"{value_text}"'
    value = value_text if value_text == "FILE" else f"[{value_text}]" if value_text == "DIR" else f'"{value_text}"'
    return f"{name}={value}"
