"""What is found of a sewing pattern before anything is simulated."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Remark:
    """Something about a pattern that its maker should know.

    kind     in two or three words, the same for all of a kind
    wrong    whether it cannot be sewn so
    where    panels and edges, as `front[3]`
    text     in words, with measures in cm
    line     in the file, where it is known; field: the path of what stands there
    """

    kind: str
    wrong: bool
    where: str
    text: str
    line: int | None = None
    field: str | None = None
    remedy: str | None = None


@dataclass(frozen=True)
class PanelSize:
    """A panel as it is cut: edges, of which some are sewn; area [m^2], width and height [m]."""

    name: str
    edges: int
    sewn: int
    area: float
    width: float
    height: float


@dataclass(frozen=True)
class Opening:
    """A hole of the garment that is not sewn shut, as its hem: edges, as `front[3]`, in order, and their length [m]."""

    edges: tuple[str, ...]
    length: float


@dataclass(frozen=True)
class Checked:
    """A pattern: its panels, seams by number and length in all [m], openings, what is to be said of it, and the height
    up to which panels are placed [m], 0 of none.
    """

    panels: tuple[PanelSize, ...]
    seams: int
    length: float
    openings: tuple[Opening, ...]
    remarks: tuple[Remark, ...]
    high: float = 0.0
