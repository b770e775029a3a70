"""The plugin under test, and tools for all checks: comparing results to the last bit, and making them twice."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import BaseModel

from nuno.plugin_contract import registry
from nuno.plugin_contract.guards import Foreign
from nuno.scene.files import SceneFiles
from nuno_schemas.plugin import Files


@dataclass(frozen=True)
class Subject:
    """A plugin with a configuration. It is guarded: the results of its methods are checked against their layout."""

    group: str
    name: str
    plugin: Any
    config: BaseModel
    files: Files


def make_subject(group: str, name: str, config: Mapping[str, Any], folder: Path) -> Subject:
    """Return the installed plugin of a name. Raises BadInput for an unknown one, ValidationError for wrong fields."""
    plugin = registry.load(group, name)
    if not isinstance(plugin, Foreign):
        plugin = Foreign(plugin, group, name, registry.package_version(group, name))
    return Subject(group, name, plugin, plugin.Config.model_validate(config), SceneFiles(folder))


def content(value: Any) -> Any:
    """Return a value for == to the last bit: bytes of arrays, fields of dataclasses and mappings, without functions."""
    if isinstance(value, np.ndarray):
        return value.dtype.str, value.shape, value.tobytes()
    if is_dataclass(value):
        return tuple(content(getattr(value, field.name)) for field in fields(value))
    if isinstance(value, Mapping):
        return {key: content(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return tuple(content(item) for item in value)
    return None if callable(value) else value


def made_twice(make: Callable[[], Any], *arguments: Any) -> Any:
    """Return the result of `make`, if it is the same to the last bit on another thread, and `arguments` not changed."""
    before = content(arguments)
    first = make()
    with ThreadPoolExecutor(1) as other:
        again = other.submit(make).result()
    assert content(first) == content(again), "the same arguments gave something else on another thread"
    assert content(arguments) == before, "an argument was changed"
    return first
