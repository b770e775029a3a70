"""Results of checking a sewing pattern before any simulation."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field


@dataclass(frozen=True)
class Remark:
    """A remark on a pattern for its maker.

    kind     kind of remark, two or three words
    wrong    whether it makes the pattern impossible to sew
    where    panels and edges, as `front[3]`
    text     explanation, with measures in cm
    line     line of the file, if known; field: the path of the field there
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
    """A cut panel: number of edges and of sewn edges, area [m^2], width and height [m]."""

    name: str
    edges: int
    sewn: int
    area: float
    width: float
    height: float


@dataclass(frozen=True)
class Opening:
    """An opening of the garment, such as its hem: edges, as `front[3]`, in order, and their total length [m]."""

    edges: tuple[str, ...]
    length: float


@dataclass(frozen=True)
class Checked:
    """A checked pattern: panels, number and total length of seams [m], openings, remarks, the height up to which panels
    are placed [m], 0 without placement, and the edges by name, as `front[3]`: length [m] and the edge it is sewn to.
    """

    panels: tuple[PanelSize, ...]
    seams: int
    length: float
    openings: tuple[Opening, ...]
    remarks: tuple[Remark, ...]
    high: float = 0.0
    edges: Mapping[str, tuple[float, str | None]] = field(default_factory=dict)


@dataclass(frozen=True)
class Altered:
    """A pattern's file with an edge of another length: its text, and the seams whose edges no longer have their former
    ratio, each with the difference.
    """

    text: str
    eased: tuple[str, ...]
