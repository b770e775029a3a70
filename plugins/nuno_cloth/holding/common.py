"""Functions that `attach` and `release` share."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from pydantic import Field

from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Fabric, Int, State
from nuno_schemas.operation import Changed, Outcome

VertexNumber = Annotated[int, Field(ge=0)]
VERTICES = "or just these, by their numbers in the object"


def check_vertices(numbers: tuple[int, ...], fabric: Fabric) -> Int:
    """Return the numbers (k,) of vertices. Raises BadInput if there are none, one does not exist or is named twice."""
    chosen = np.array(numbers, np.int64)
    if not len(chosen):
        raise BadInput("no vertex is named", field="vertices", value=[], limit="one or more")
    if chosen.max() >= fabric.number:
        limit = f"0 to {fabric.number - 1}"
        remedy = "numbers are those of the object; or take what is within reach of a body: within: 1 cm"
        raise BadInput("there is no such vertex", field="vertices", value=int(chosen.max()), limit=limit, remedy=remedy)
    names, counts = np.unique(chosen, return_counts=True)
    if counts.max() > 1:
        raise BadInput("this vertex is named twice", field="vertices", value=int(names[counts.argmax()]))
    return chosen.astype(np.int32)


def unchanged(fabric: Fabric, state: State, vertices: int) -> Outcome:
    """Return a fabric of the same vertices, in place, with the numbers bound or released, and held by bodies."""
    facts = {"vertices": vertices, "held": sum(len(binding.vertices) for binding in fabric.bindings)}
    return Outcome(facts, changed=Changed(fabric, state, np.arange(fabric.number, dtype=np.int32)))
