"""The reference of messages, generated from the schemas: docs/reference/messages.md."""

from __future__ import annotations

import re
from typing import Any, get_args

from pydantic import BaseModel

from nuno.cli.reference_tables.fields import table
from nuno_schemas.messages import MODELS, POSES, TOPICS, Header, Topic

FOXGLOVE = "https://docs.foxglove.dev/docs/visualization/message-schemas/introduction"
INTRODUCTION = f"""\
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
    parts = [INTRODUCTION, "## Topics\n", table(["topic", "type", "encoding", "when", "recorded", "holds"], rows)]
    parts += [f"\n## Header\n\nThe attachment of each message, as JSON. {_description(Header)}\n", _fields(Header)]
    for name, model in MODELS.items():
        parts += [f"\n## {name}\n\n{_description(model)}\n", _fields(model)]
        nested = [one for field in model.model_fields.values() for one in get_args(field.annotation) if _is_model(one)]
        for one in nested:
            parts += [f"\n### {one.__name__}\n\n{_description(one)}\n", _fields(one)]
    return "\n".join([*parts, f"\n{ARRAYS}"])


def _is_model(kind: Any) -> bool:
    return isinstance(kind, type) and issubclass(kind, BaseModel)


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
