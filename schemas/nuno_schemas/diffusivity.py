"""How the diffusion of a dye depends on how much there is of it, as a scene says."""

from __future__ import annotations

from typing import Any

from pydantic import Field, model_validator
from pydantic_core import PydanticCustomError

from nuno_schemas.parts import Part


class WeiszZollinger(Part):
    """Diffusion that is slower where there is more dye: D = D0 P T min(cap, phi0 / phi) (dye paper, equation 4).

    What passes a face follows from the integral of D over phi between its two amounts.
    """

    phi0: float = Field(gt=0, le=1e6, description="mobile dye at equilibrium; where there is as much, D = D0 P T")
    cap: float = Field(gt=0, le=1e6, description="the most that phi0 / phi counts as, which has no bound without dye")

    @model_validator(mode="before")
    @classmethod
    def _capped(cls, data: Any) -> Any:
        if isinstance(data, dict) and "cap" not in data:
            problem = "phi0 / phi has no bound where there is no dye; add a cap, for example cap: 10"
            raise PydanticCustomError("no_cap", problem)
        return data
