"""Reference pages of the documentation, as Markdown from the code: commands, fields and messages (`nuno schema`)."""

from __future__ import annotations

import argparse
import json
import re
from collections.abc import Iterator, Sequence
from typing import Any

from pydantic import BaseModel

from nuno import cli
from nuno.plugin_contract import registry
from nuno.scene.json_schema import PLACES, scene_schema
from nuno.scene.validation_errors import models_in
from nuno_schemas.messages import MODELS, POSES, TOPICS, Header, Topic
from nuno_schemas.plugin import GROUPS

# The reference of every field of a scene, generated from the JSON Schema: docs/reference/fields.md.


def table(headings: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return a table of rows under headings, without empty columns."""
    used = [i for i in range(len(headings)) if not rows or any(row[i] for row in rows)]
    lines = [[line[i].replace("|", "\\|") for i in used] for line in (headings, ["---"] * len(headings), *rows)]
    return "\n".join("| " + " | ".join(cells) + " |" for cells in lines)


def plain(text: str | None) -> str:
    """Return a docstring's first paragraph in one line, with markup characters escaped."""
    paragraph = " ".join((text or "").strip().split("\n\n")[0].split())
    return paragraph.replace("*", "\\*").replace("<", "\\<")


def anchor(heading: str) -> str:
    """Return the anchor of a heading of letters, digits, blanks, brackets and underscores, as code hosts make it."""
    return heading.lower().replace(" ", "-").replace("(", "").replace(")", "").replace(".", "")


FIELDS = """\
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
"""Kind of a plugin of each group, for headings."""
TYPES = {"number": "number", "integer": "whole number", "string": "text", "boolean": "true or false",
         "object": "mapping"}  # fmt: skip
LIMITS = {"exclusiveMinimum": "> ", "minimum": "≥ ", "exclusiveMaximum": "< ", "maximum": "≤ "}
PATTERNS = {"^[A-Za-z]": "name", "^#": 'colour, `"#cd5c5c"` or a name of CSS'}
HEADINGS = ("field", "takes", "unit", "default", "limits", "meaning")
MANY = 20
"""Number of names from which on they are not listed, such as those of colours."""


def describe_fields() -> str:
    """Return the page; imports every installed plugin."""
    return _Page(scene_schema()).text()


class _Page:
    """The parts of a scene, then each group's plugins, then the parts of their fields, each where first named."""

    def __init__(self, schema: dict[str, Any]) -> None:
        self.schema = schema
        self.parts: dict[str, str] = {}
        """Heading of each definition; equal definitions of several plugins share one."""
        self._described_keys: dict[str, str] = {}

    def text(self) -> str:
        groups = list(dict.fromkeys(PLACES.values()))
        plugins = [(group, sorted(registry.installed(group))) for group in groups]
        lines = [FIELDS, "## Scene\n", self._table(self.schema), *self._describe_parts("###")]
        for group, names in plugins:
            lines.append(f"\n## {KINDS[group].capitalize()}s\n\n{GROUPS[group].capitalize().split(':')[0]}.")
            for name in names:
                cls, choice = registry.load(group, name), self._choice(group, name)
                text = " ".join(dict.fromkeys(filter(None, (plain(cls.__doc__), plain(cls.Config.__doc__)))))
                lines += [f"\n### {name} ({KINDS[group]})\n\n{text}\n", self._table(choice)]
            lines += self._describe_parts("####")
        return "\n".join(lines) + "\n"

    def _choice(self, group: str, name: str) -> dict[str, Any]:
        """Return the schema of a plugin's fields, from the first place for a plugin of its group."""
        part, field = next(place for place, of in PLACES.items() if of == group)
        owner = self.schema if part == "Scene" else self.schema["$defs"][part]
        place = owner["properties"][field]
        choices: list[dict[str, Any]] = place["oneOf"] if "oneOf" in place else place["items"]["oneOf"]
        return next(one for one in choices if one.get("properties", {}).get("plugin", {}).get("const") == name)

    def _describe_parts(self, level: str) -> Iterator[str]:
        """Describe each part that has been named and not described yet."""
        while waiting := [key for key in self.parts if key not in self._described_keys.values()]:
            for key in waiting:
                part = self.schema["$defs"][key]
                self._described_keys[self._content(key)] = key
                yield f"\n{level} {self.parts[key]}\n\n{plain(part.get('description'))}\n"
                yield self._table(part)

    def _content(self, key: str) -> str:
        """Return the content of a definition without its owner: equal for definitions that several plugins share."""
        prefix = key.rpartition(".")[0]
        return json.dumps([key.rpartition(".")[2], self.schema["$defs"][key]]).replace(f"#/$defs/{prefix}.", "#")

    def _link(self, key: str) -> str:
        key = self._described_keys.get(self._content(key), key)
        equal = next((one for one in self.parts if self._content(one) == self._content(key)), key)
        if equal not in self.parts:
            plugin, name = ([*key.split("."), ""][-3:-1]) if "." in key else ("", key)
            taken = name in self.parts.values() or name == "Scene"
            self.parts[equal] = f"{name} ({plugin})" if taken else name
        heading = self.parts[equal]
        return f"[{heading}](#{anchor(heading)})"

    def _table(self, part: dict[str, Any]) -> str:
        rows = []
        for name, field in part.get("properties", {}).items():
            if name == "plugin":
                continue
            units = ", ".join(dict.fromkeys(str(one["unit"]) for one in _inside(field) if one.get("unit")))
            limits = ", ".join(dict.fromkeys(limit for one in _inside(field) for limit in _limits(one)))
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
        """Yield a link to the group for plugins, and every other alternative by itself."""
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


def _inside(node: dict[str, Any]) -> Iterator[dict[str, Any]]:
    """Yield a field's schema and all within it, without other parts and plugins."""
    yield node
    nodes = [*node.get("anyOf", ()), *node.get("oneOf", ()), *node.get("prefixItems", ())]
    nodes += [node[key] for key in ("items", "additionalProperties") if isinstance(node.get(key), dict)]
    for one in nodes:
        if "properties" not in one:
            yield from _inside(one)


def _limits(node: dict[str, Any]) -> Iterator[str]:
    bounds = [f"{sign}{node[key]:g}" for key, sign in LIMITS.items() if key in node]
    if bounds:
        yield " and ".join(bounds)
    least, most = node.get("minItems"), node.get("maxItems")
    if "items" in node and (least or most):
        yield f"{least or 0} to {most} of them" if most else f"{least} of them at least"
    if "maxLength" in node:
        yield f"at most {node['maxLength']} letters"


def _written(value: Any) -> str:
    """Return a value as a scene writes it."""
    return json.dumps(value, ensure_ascii=False).replace('"', "")


def _default(field: dict[str, Any]) -> str:
    if (value := field.get("default")) in (None, ""):
        return "left out"
    if isinstance(value, dict):
        return "its own"
    return f"`{_written(value)}`"


COMMANDS_PAGE = """\
# Commands

<!-- made by: nuno schema --commands -->

`nuno COMMAND --help` says the same. Exit codes: 0 done, 1 failed, diverged or ended by a signal, 2 bad input.
"""


def describe_commands() -> str:
    """Return the page; imports every command."""
    parts = [COMMANDS_PAGE]
    for name in cli.COMMANDS:
        module, parser = cli.parser_of(name)
        parts += _command(f"nuno {name}", parser, "##")
        # Commands with subcommands that have their own arguments: `nuno bench`.
        for kind in getattr(module, "COMMANDS", ()):
            parts += _command(f"nuno {name} {kind}", module.parser_of(kind)[1], "###")
    return "\n".join(parts) + "\n"


def _command(name: str, parser: argparse.ArgumentParser, level: str) -> Iterator[str]:
    yield f"\n{level} {name}\n\n{plain(parser.description)}\n"
    rows = [row for action in parser._actions if (row := _row(action, parser._get_formatter()))]
    yield table(["argument", "default", "meaning"], rows) if rows else "No arguments."


def _row(action: argparse.Action, formatter: argparse.HelpFormatter) -> list[str] | None:
    """Return an argument, its default and its meaning; None for --help and hidden ones."""
    if isinstance(action, argparse._HelpAction) or action.help == argparse.SUPPRESS:
        return None
    values = "" if action.nargs == 0 else _values(action)
    written = ", ".join(action.option_strings)
    text = formatter._expand_help(action) if action.help else ""
    shown = action.default not in (None, False, [], (), argparse.SUPPRESS) and "default" not in text
    return [f"`{' '.join(filter(None, [written, values]))}`", f"`{action.default}`" if shown else "", plain(text)]


def _values(action: argparse.Action) -> str:
    if action.choices is not None and action.metavar is None:
        value = "{" + ",".join(map(str, action.choices)) + "}"
    else:
        name = action.metavar or (action.dest.upper() if action.option_strings else action.dest)
        value = name if isinstance(name, str) else " ".join(name)
    many = {"?": f"[{value}]", "*": f"[{value} ...]", "+": f"{value} ...", argparse.REMAINDER: "..."}
    return many.get(str(action.nargs), value) if action.nargs else value


# The reference of messages, generated from the schemas: docs/reference/messages.md.

FOXGLOVE = "https://docs.foxglove.dev/docs/visualization/message-schemas/introduction"
MESSAGES = f"""\
# Messages

<!-- made by: nuno schema --messages -->

What a run publishes under `nuno/RUN/TOPIC`, and what a recording holds under the same topics. Those of the encoding
JSON are objects of `nuno_schemas.messages`; binary ones are protobuf, either [Foxglove's]({FOXGLOVE})
or `nuno.Arrays`, and each recording holds their schemas. [Listen to a run](../how-to/bus.md) shows how.
"""
ARRAYS = """\
## nuno.Arrays

Arrays by name, little-endian and in C order, and a JSON object of what is no array. `nuno.bus.encodings` decodes it.

```proto
message Array {
  string name = 1;
  string dtype = 2;            // float64, float32, int64, int32, uint8, int8, bool
  repeated uint32 shape = 3;
  bytes data = 4;
}

message Arrays {
  string text = 1;             // JSON
  repeated Array arrays = 2;
}
```
"""


def describe_messages() -> str:
    """Return the page."""
    rows = [[f"`{one.name}`", f"`{one.schema}`", one.encoding, one.when, "yes" if one.recorded else "no", _holds(one)]
            for one in (*TOPICS.values(), POSES)]  # fmt: skip
    parts = [MESSAGES, "## Topics\n", table(["topic", "type", "encoding", "when", "recorded", "holds"], rows)]
    parts += [f"\n## Header\n\nThe attachment of each message, as JSON. {_description(Header)}\n", _fields(Header)]
    for name, model in MODELS.items():
        parts += [f"\n## {name}\n\n{_description(model)}\n", _fields(model)]
        for one in (one for field in model.model_fields.values() for one in models_in(field.annotation)):
            parts += [f"\n### {one.__name__}\n\n{_description(one)}\n", _fields(one)]
    return "\n".join([*parts, f"\n{ARRAYS}"])


def _holds(topic: Topic) -> str:
    link = topic.schema.lower().replace(".", "")
    return topic.holds or f"[{topic.schema}](#{link})"


def _description(model: type[BaseModel]) -> str:
    return " ".join((model.__doc__ or "").split())


def _fields(model: type[BaseModel]) -> str:
    rows = [[f"`{name}`", _type(field.annotation), " ".join((field.description or "").split())]
            for name, field in model.model_fields.items()]  # fmt: skip
    return table(["field", "type", ""], rows)


def _type(annotation: Any) -> str:
    """Return the name of a type in Python, with null for None."""
    text = annotation.__name__ if isinstance(annotation, type) and "[" not in str(annotation) else str(annotation)
    text = text.replace("None", "null").replace("typing.", "").replace("nuno_schemas.messages.", "")
    text = re.sub(r"Annotated\[(\w+), [^]]*\]", r"\1", text)
    if text.startswith("Literal["):
        return " or ".join(f"`{word}`" for word in re.findall(r"'([^']*)'", text))
    return f"`{text}`".replace("|", "or")
