"""Operations that a scene applies to its cloth while it goes on."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import Field
from pydantic_core import PydanticCustomError

from nuno_schemas.errors import nearest
from nuno_schemas.parts import Choice, Name
from nuno_schemas.units import quantity

Moment = Annotated[float, quantity("s", ge=0)]


class Applied(Choice):
    """An operation that changes a piece of cloth while the scene goes on."""

    at: Moment = Field(default=0.0, description="when [s]; the frame nearest to it is the last without")
    object: Name | None = Field(default=None, description="the object that is changed; the only one where left out")


def require_objects(operations: list[Applied], names: list[str], duration: float) -> None:
    """Refuse operations on objects that are not there, or after the end [s]."""
    for i, applied in enumerate(operations):
        context: dict[str, Any] = {"inside": ("operations", i, "object")}
        if applied.object is None and len(names) != 1:
            context["known"] = nearest("", names)
            raise PydanticCustomError("which_object", "say which object it changes; {known}", context)
        if applied.object is not None and applied.object not in names:
            context["known"] = nearest(applied.object, names)
            raise PydanticCustomError("no_object", "no object has this name; {known}", context)
        if applied.at > duration:
            context = {"end": f"{duration:g}", "inside": ("operations", i, "at")}
            problem = "the scene ends before, at {end} s; lengthen it, or apply this earlier"
            raise PydanticCustomError("too_late", problem, context)
