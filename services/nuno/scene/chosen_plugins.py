"""Plugins of a scene, with their validated configurations."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any

from pydantic import BaseModel, ValidationError

from nuno.plugin_contract import registry
from nuno.scene import yaml_lines
from nuno.scene.files import SceneFiles
from nuno.scene.validation_errors import NO_FIELD, OVERRIDDEN, explain, located
from nuno.scene.yaml_lines import dotted
from nuno_schemas.errors import BadInput
from nuno_schemas.operation import arranges
from nuno_schemas.parts import AUTO, Choice
from nuno_schemas.scene import Applied


@dataclass
class Chosen:
    """A plugin chosen by a scene: the instance, its validated configuration, its field."""

    group: str
    plugin: Any
    config: BaseModel
    field: str
    given: Mapping[str, Any]
    """Configuration as the scene has it."""

    @property
    def name(self) -> str:
        return str(self.plugin.name)


def choose_plugin(
    group: str, choice: Choice, place: yaml_lines.Path, file: str, lines: Mapping[yaml_lines.Path, int]
) -> Chosen:
    """Return the plugin that a scene names, with its validated configuration. Raises BadInput."""
    try:
        plugin = registry.load(group, choice.plugin, (AUTO,) if group == "nuno.integrators" else ())
    except BadInput as error:
        raise located(error, file, lines, dotted((*place, "plugin"))) from None
    try:
        return Chosen(group, plugin, plugin.Config.model_validate(choice.config), dotted(place), choice.config)
    except ValidationError as error:
        common_fields = tuple(type(choice).model_fields)
        explained = explain(error, choice.config, place, file, lines, plugin.Config, common_fields)
        raise _name_other_plugins(explained, group, choice, place, lines) from None
    except BadInput as error:
        raise located(error, file, lines, dotted((*place, "plugin"))) from None
    except Exception as error:  # from another distribution's validator: pydantic passes most through
        problem = f"the configuration of {choice.plugin!r} cannot be read: {type(error).__name__}: {error}"
        raise located(BadInput(problem), file, lines, dotted(place)) from error


def _name_other_plugins(
    error: BadInput, group: str, choice: Choice, place: yaml_lines.Path, lines: Mapping[yaml_lines.Path, int]
) -> BadInput:
    """Add the plugins that have an unknown field to its error, and how to remove the field."""
    here, _, name = (error.field or "").rpartition(".")
    if error.problem != NO_FIELD or here != dotted(place):
        return error
    others = []
    for other in sorted(registry.installed(group)):
        with suppress(BadInput):
            others += [other] if name in registry.load(group, other).Config.model_fields else []
    if not others:
        return error
    remedy = f"{choice.plugin} has none, it is a field of {', '.join(others)}; {error.remedy}"
    if lines.get((*place, "plugin")) == OVERRIDDEN != lines.get((*place, name)):
        remedy = f'it is of the plugin before: without the fields of that, --set "{here}={{plugin: {choice.plugin}}}"'
    return replace(error, remedy=remedy)


def choose_operation(
    applied: Applied, place: yaml_lines.Path, file: str, lines: Mapping[yaml_lines.Path, int], files: SceneFiles
) -> Chosen:
    """Return an operation that changes cloth, with the content of its files. Raises BadInput."""
    chosen = choose_plugin("nuno.operations", applied, place, file, lines)
    try:
        if arranges(chosen.plugin):
            if applied.at > 0.0:
                value, remedy = f"{applied.at:g} s", "leave it out"
                raise BadInput("this operation is for the start", field="at", value=value, remedy=remedy)
            return chosen
        if not hasattr(chosen.plugin, "resolve"):
            raise BadInput("this operation does not change cloth that moves", field="plugin", value=chosen.name)
        return replace(chosen, config=chosen.plugin.resolve(chosen.config, files))
    except BadInput as error:
        raise located(error, file, lines, dotted(place)) from None
