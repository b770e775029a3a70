"""JSON Schema of a scene: the contract's, with each plugin's own fields under its name."""

from __future__ import annotations

from typing import Any

from nuno.plugin_contract import registry
from nuno_schemas.dyeing import YARNS
from nuno_schemas.parts import AUTO
from nuno_schemas.scene import Scene

PLACES = {
    ("Object", "model"): "nuno.models",
    ("Body", "collider"): "nuno.colliders",
    ("Body", "motion"): "nuno.motions",
    ("Body", "contact"): "nuno.contacts",
    ("Scene", "solver"): "nuno.integrators",
    ("Scene", "contact"): "nuno.contacts",
    ("Scene", "cloth_contact"): "nuno.cloth_contacts",
    ("Scene", "forces"): "nuno.forces",
    ("Scene", "operations"): "nuno.operations",
    ("Dyeing", "cloth"): "nuno.dye_cloths",
    ("Dyeing", "solver"): "nuno.dye_solvers",
    ("Dyeing", "picture"): "nuno.dye_pictures",
    ("Dyestuff", "isotherm"): "nuno.isotherms",
    ("View", "yarns"): "nuno.yarn_pictures",
}
"""Group of the plugin that each field of a scene names."""
_COMMON_FIELDS = {
    "nuno.integrators": "Solver",
    "nuno.dye_solvers": "DyeSolver",
    "nuno.dye_pictures": "DyePicture",
    "nuno.operations": "Applied",
    "nuno.cloth_contacts": "ClothContact",
}
"""Models whose fields are mixed with those of a plugin."""

_DEFAULTS = {"nuno.dye_pictures": YARNS}
"""Plugin that a group takes without a name."""


def scene_schema() -> dict[str, Any]:
    """Return the whole schema; imports every installed plugin."""
    schema = Scene.model_json_schema()
    definitions = schema["$defs"]
    for (part, field), group in PLACES.items():
        owner = schema if part == "Scene" else definitions[part]
        place = owner["properties"][field]
        common = definitions[_COMMON_FIELDS[group]]["properties"] if group in _COMMON_FIELDS else {}
        choices = [_choice(group, name, definitions, common) for name in sorted(registry.installed(group))]
        if place.get("type") == "array":
            place["items"] = {"oneOf": choices}
        else:
            for key in ("$ref", "anyOf", "default"):
                place.pop(key, None)
            place["oneOf"] = [*choices, *(_short(group) if field == "solver" else ())]
            if field == "cloth_contact":
                names = ["none", *sorted(registry.installed(group))]
                place["oneOf"].append({"title": "by name", "type": "string", "enum": names})
            if field in ("isotherm", "yarns"):
                place["oneOf"].append({"type": "null"})
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **schema}


def _short(group: str) -> list[dict[str, Any]]:
    """Return the short forms of a solver: its name, and `auto`."""
    auto = {"type": "object", "properties": {"plugin": {"const": AUTO}}, "additionalProperties": False}
    names = [AUTO, *sorted(registry.installed(group))]
    return [{"title": "by name", "type": "string", "enum": names}, {"title": AUTO, "required": ["plugin"], **auto}]


def _choice(group: str, name: str, definitions: dict[str, Any], common: dict[str, Any]) -> dict[str, Any]:
    """Return the schema of one plugin's fields and the common ones, with `plugin` fixed to its name."""
    prefix = f"{group}.{name}."  # two plugins may use one name for different parts
    config = registry.load(group, name).Config.model_json_schema(ref_template=f"#/$defs/{prefix}{{model}}")
    definitions |= {prefix + key: value for key, value in config.pop("$defs", {}).items()}
    properties = common | {"plugin": {"const": name}, **config.get("properties", {})}
    return {
        "title": name,
        "type": "object",
        "properties": properties,
        "required": [*([] if name == _DEFAULTS.get(group) else ["plugin"]), *config.get("required", [])],
        "additionalProperties": False,
    }
