"""Every field of a scene, made from the JSON Schema: docs/reference/fields.md."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any

from nuno import registry
from nuno.reference.markdown import anchor, plain, table
from nuno.scene.json_schema import PLACES, scene_schema
from nuno_schemas.plugin import GROUPS

INTRODUCTION = """\
# Scene fields

<!-- made by: nuno schema --fields -->

Every field that a scene may have, as `nuno schema` has them for editors: what it takes, its unit, default and limits,
and what it means. A quantity is a number in the unit that is given, or text with a unit of its own, such as `"5 mm"`.
A field without a default has to be given. *Left out* is a default, too, and a part may have its own.
[Scenes](scenes.md) shows how they go together.
"""
KINDS = {
    "nuno.models": "model", "nuno.forces": "force", "nuno.integrators": "solver", "nuno.colliders": "collider",
    "nuno.motions": "motion", "nuno.contacts": "contact", "nuno.cloth_contacts": "cloth contact",
    "nuno.operations": "operation", "nuno.dye_cloths": "dye cloth", "nuno.dye_solvers": "dye solver",
    "nuno.dye_pictures": "dye picture", "nuno.yarn_pictures": "yarn picture", "nuno.isotherms": "isotherm",
}  # fmt: skip
"""What a plugin of a group is, beside its name."""
TYPES = {"number": "number", "integer": "whole number", "string": "text", "boolean": "true or false",
         "object": "mapping"}  # fmt: skip
LIMITS = {"exclusiveMinimum": "> ", "minimum": "≥ ", "exclusiveMaximum": "< ", "maximum": "≤ "}
PATTERNS = {"^[A-Za-z]": "name", "^#": 'colour, `"#cd5c5c"` or a name of CSS'}
HEADINGS = ("field", "takes", "unit", "default", "limits", "meaning")
MANY = 20
"""Names that are too many to be listed: those of colours."""


def describe_fields() -> str:
    """The page; imports every installed plugin."""
    return _Page(scene_schema()).text()


class _Page:
    """The parts of a scene, then each group's plugins, then the parts of their fields, each where first named."""

    def __init__(self, schema: dict[str, Any]) -> None:
        self.schema = schema
        self.parts: dict[str, str] = {}
        """Of each definition its heading; the same one under several plugins has one."""
        self._known: dict[str, str] = {}

    def text(self) -> str:
        groups = list(dict.fromkeys(PLACES.values()))
        plugins = [(group, sorted(registry.installed(group))) for group in groups]
        own = [INTRODUCTION, "## Scene\n", self._table(self.schema), *self._described("###")]
        for group, names in plugins:
            own.append(f"\n## {KINDS[group].capitalize()}s\n\n{GROUPS[group].capitalize().split(':')[0]}.")
            for name in names:
                cls, choice = registry.load(group, name), self._choice(group, name)
                said = " ".join(dict.fromkeys(filter(None, (plain(cls.__doc__), plain(cls.Config.__doc__)))))
                own += [f"\n### {name} ({KINDS[group]})\n\n{said}\n", self._table(choice)]
            own += self._described("####")
        return "\n".join(own) + "\n"

    def _choice(self, group: str, name: str) -> dict[str, Any]:
        """The fields of a plugin, wherever a scene names one of its group."""
        part, field = next(place for place, of in PLACES.items() if of == group)
        owner = self.schema if part == "Scene" else self.schema["$defs"][part]
        place = owner["properties"][field]
        choices: list[dict[str, Any]] = place["oneOf"] if "oneOf" in place else place["items"]["oneOf"]
        return next(one for one in choices if one.get("properties", {}).get("plugin", {}).get("const") == name)

    def _described(self, level: str) -> Iterator[str]:
        """Each part that has been named and not described yet."""
        while waiting := [key for key in self.parts if key not in self._known.values()]:
            for key in waiting:
                part = self.schema["$defs"][key]
                self._known[self._like(key)] = key
                yield f"\n{level} {self.parts[key]}\n\n{plain(part.get('description'))}\n"
                yield self._table(part)

    def _like(self, key: str) -> str:
        """What a definition says, whoever has it: alike for those that several plugins share."""
        prefix = key.rpartition(".")[0]
        return json.dumps([key.rpartition(".")[2], self.schema["$defs"][key]]).replace(f"#/$defs/{prefix}.", "#")

    def _link(self, key: str) -> str:
        key = self._known.get(self._like(key), key)
        alike = next((one for one in self.parts if self._like(one) == self._like(key)), key)
        if alike not in self.parts:
            plugin, name = ([*key.split("."), ""][-3:-1]) if "." in key else ("", key)
            taken = name in self.parts.values() or name == "Scene"
            self.parts[alike] = f"{name} ({plugin})" if taken else name
        heading = self.parts[alike]
        return f"[{heading}](#{anchor(heading)})"

    def _table(self, part: dict[str, Any]) -> str:
        rows = []
        for name, field in part.get("properties", {}).items():
            if name == "plugin":
                continue
            limits, units = (", ".join(dict.fromkeys(found(field))) for found in (_limits, _units))
            meaning = plain(field.get("description")) or ("which one of several" if "const" in field else "")
            default = "" if name in part.get("required", ()) else _default(field)
            rows.append([f"`{name}`", " or ".join(_unique(self._takes(field))), units, default, limits, meaning])
        return table(HEADINGS, rows) if rows else "No fields of its own."

    def _takes(self, node: dict[str, Any]) -> Iterator[str]:
        if "$ref" in node:
            yield self._link(node["$ref"].removeprefix("#/$defs/"))
        elif "unit" in node:
            yield "quantity" if node["unit"] else "number"
        elif "const" in node:
            yield f"`{_written(node['const'])}`"
        elif "enum" in node:
            if len(node["enum"]) < MANY:
                yield ", ".join(f"`{one}`" for one in node["enum"])
        elif "prefixItems" in node:
            inner = [" or ".join(_unique(self._takes(one))) for one in node["prefixItems"]]
            yield f"{len(inner)} of {inner[0]}" if len(set(inner)) == 1 else f"[{', '.join(inner)}]"
        elif "items" in node:
            yield f"list of {' or '.join(_unique(self._takes(node['items'])))}"
        elif isinstance(node.get("additionalProperties"), dict):
            yield f"mapping to {' or '.join(_unique(self._takes(node['additionalProperties'])))}"
        elif "pattern" in node:
            yield next(word for start, word in PATTERNS.items() if node["pattern"].startswith(start))
        elif several := node.get("anyOf") or node.get("oneOf"):
            yield from self._takes_one_of(several)
        elif node.get("type") != "null":
            yield TYPES[node["type"]]

    def _takes_one_of(self, several: list[dict[str, Any]]) -> Iterator[str]:
        """Plugins of a group by a link to it; all else one by one."""
        names = {one["properties"]["plugin"]["const"] for one in several if "plugin" in one.get("properties", {})}
        if names - {"auto"}:
            group = next(group for group in KINDS if names - {"auto"} == set(registry.installed(group)))
            heading = f"{KINDS[group].capitalize()}s"
            yield f"[{KINDS[group]}](#{anchor(heading)})"
            several = [one for one in several if "properties" not in one and one.get("type") != "null"]
            yield from ("its name" if "enum" in one else next(self._takes(one)) for one in several)
        else:
            for one in several:
                yield from self._takes(one)


def _unique(words: Iterator[str]) -> list[str]:
    return list(dict.fromkeys(words))


def _inside(node: dict[str, Any]) -> list[dict[str, Any]]:
    """What a field's schema is made of, without other parts and plugins."""
    found = [*node.get("anyOf", ()), *node.get("oneOf", ()), *node.get("prefixItems", ())]
    found += [node[key] for key in ("items", "additionalProperties") if isinstance(node.get(key), dict)]
    return [one for one in found if "properties" not in one]


def _units(node: dict[str, Any]) -> Iterator[str]:
    if node.get("unit"):
        yield str(node["unit"])
    for one in _inside(node):
        yield from _units(one)


def _limits(node: dict[str, Any]) -> Iterator[str]:
    bounds = [f"{sign}{node[key]:g}" for key, sign in LIMITS.items() if key in node]
    if bounds:
        yield " and ".join(bounds)
    least, most = node.get("minItems"), node.get("maxItems")
    if "items" in node and (least or most):
        yield f"{least or 0} to {most} of them" if most else f"{least} of them at least"
    if "maxLength" in node:
        yield f"at most {node['maxLength']} letters"
    for one in _inside(node):
        yield from _limits(one)


def _written(value: Any) -> str:
    """As a scene would have it."""
    return json.dumps(value, ensure_ascii=False).replace('"', "")


def _default(field: dict[str, Any]) -> str:
    if (value := field.get("default")) in (None, ""):
        return "left out"
    if isinstance(value, dict):
        return "its own"
    return f"`{_written(value)}`"
