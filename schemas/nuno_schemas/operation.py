"""Operations: plugins that make something new of a fabric and where it is."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar, Protocol

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel

from nuno_schemas.curves import YarnCurves
from nuno_schemas.fabric import Fabric, Float, State


@dataclass(frozen=True)
class Surface:
    """Closed meshes in the world at one time: vertices (n, 3) [m], faces (f, 3) counter-clockwise from outside."""

    vertices: Float
    faces: NDArray[np.int32]


@dataclass(frozen=True)
class Outcome:
    """What an operation made.

    `facts` are numbers for a report; `curves` yarns as curves, where it makes any, and `arrays` what more
    there is to say of each of their points, or of the fabric's where it makes no curves.
    """

    facts: Mapping[str, float]
    curves: YarnCurves | None = None
    arrays: Mapping[str, NDArray[Any]] = field(default_factory=dict)


class Operation(Protocol):
    """Makes something new of a fabric and where it is."""

    name: ClassVar[str]
    Config: ClassVar[type[BaseModel]]

    def apply(self, config: Any, fabric: Fabric, state: State, skin: Surface | None) -> Outcome:
        """`skin` are the bodies that are meshes, None where there is none. Changes none of its arguments."""
        ...
