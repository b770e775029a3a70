"""From a System to the layout of the kernels, and back."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from nuno_kernels import threads_available
from nuno_kernels.acceleration import Packed
from nuno_kernels.hinges import pack_hinges
from nuno_kernels.spring_packing import pack_springs
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Fabric, Float
from nuno_schemas.plugin import System

if TYPE_CHECKING:
    from nuno_kernels.bindings import Bindings
    from nuno_kernels.slides import Slides
    from nuno_kernels.yarns import YarnLists

PARALLEL_FROM = 4096
"""Fewest vertices that run on several threads, two blocks. Whether they do in a frame is found by trying."""

FUSED = ("contact", "wind", "particle_wind")

JOINED = ("bindings", "slides", "python")
"""Kinds of terms of which a system may have several."""

Extra = Callable[[Float, Float, float, Float], None]


def to_rows(array: Float, out: Float | None = None) -> Float:
    """(n, 3) -> C-contiguous (3, n) that shares no memory with it.

    Not np.ascontiguousarray: one vertex transposed is contiguous as it is, and would be handed back as a view.
    """
    if out is None:
        return np.array(array.T, np.float64, order="C")
    out[...] = array.T
    return out


def thread_count(system: System) -> int:
    """Threads that this system's kernels run on."""
    if system.fabric.number < PARALLEL_FROM:
        return 1
    return max(1, min(system.threads, threads_available()[0]))


def pack(system: System) -> Packed:
    """Kernel layout of a system. Terms of kind "python" are left to `python_terms`."""
    fabric = system.fabric
    runs, lists = pack_springs(fabric.springs, fabric.number)
    hinge_runs, hinge_lists = pack_hinges(fabric.hinges, fabric.number)
    free = ~fabric.pinned
    threads = thread_count(system)
    packed = Packed(
        inverse_mass=np.divide(1.0, fabric.mass, out=np.zeros(fabric.number), where=free),
        gravity=np.array(system.gravity, np.float64),
        damping=float(system.damping),
        runs=runs,
        lists=lists,
        hinge_runs=hinge_runs,
        hinge_lists=hinge_lists,
        bindings=_find_bindings(system),
        slides=_find_slides(system),
        yarns=_find_yarns(fabric),
        threads=threads if threads > 1 else None,
        **_find_fused(system),
    )
    python = any(term.kind == "python" for term in system.terms)
    late = True if python or packed.contact is not None else None
    return packed._replace(velocity_matters=python or reads_velocity(packed), late=late)


PARTS = {
    "springs": ("runs", "lists"),
    "hinges": ("hinge_runs", "hinge_lists"),
    "wind": ("wind_runs", "wind_lists"),
    "yarns": ("yarns",),
    "contact": ("contact",),
}
"""What a step's forces can be told apart into, and the fields of Packed that hold each."""


def silence(packed: Packed, part: str) -> Packed:
    """The same system, of the same types, one of whose PARTS does nothing.

    Being of the same types, it runs the kernels that are compiled already.
    """
    held = {name: getattr(packed, name) for name in PARTS[part]}
    return packed._replace(**{name: _silent(part, data) for name, data in held.items() if data is not None})


def _silent(part: str, data: Any) -> Any:
    if part == "contact":
        return data._replace(
            bounds=data.bounds[:0], frames=data.frames[:0], posed=data.posed[:0], posed_at=np.full(1, np.nan)
        )
    return data._replace(start=np.zeros_like(data.start))


def silence_bodies(packed: Packed) -> Packed:
    """The same system, of the same types, whose contact and bindings do nothing."""
    bindings = packed.bindings
    if bindings is not None:
        bindings = bindings._replace(vertices=bindings.vertices[:0], frames=bindings.frames[:0])
    slides = packed.slides
    if slides is not None:
        slides = slides._replace(tally=slides.tally[:0], frames=slides.frames[:0])
    return silence(packed, "contact")._replace(bindings=bindings, slides=slides)


def reads_velocity(packed: Packed) -> bool:
    """Whether any of the compiled forces depends on the velocity, or contact moves vertices after a step: an
    acceleration found before is then not that of the next step's start.
    """
    springs = (packed.runs, packed.lists)
    damped = any(part is not None and part.damped is not None and part.constants[2].any() for part in springs)
    yarns = packed.yarns
    damped |= yarns is not None and yarns.damped is not None and bool(yarns.constants[[2, 5]].any())
    moved = packed.contact is not None or packed.slides is not None
    return damped or moved or packed.damping != 0.0 or packed.air is not None


def _find_bindings(system: System) -> Bindings | None:
    """All bound vertices: data of a "bindings" term is (vertices, local, frame)."""
    parts = [term.data for term in system.terms if term.kind == "bindings"]
    if not parts:
        return None
    from nuno_kernels.bindings import make_bindings

    vertices, local, frame = (np.concatenate([np.asarray(part[c]) for part in parts]) for c in range(3))  # type: ignore[index]
    return make_bindings(vertices, local, frame) if vertices.size else None


def _find_slides(system: System) -> Slides | None:
    """All bodies that vertices slide on: data of a "slides" term is (bodies, number of frames)."""
    parts: list[Any] = [term.data for term in system.terms if term.kind == "slides"]
    if not parts:
        return None
    from nuno_kernels.slides import make_slides

    fabric, bodies = system.fabric, [body for part in parts for body in part[0]]
    return make_slides(bodies, parts[0][1], np.where(fabric.pinned, 0.0, fabric.mass))


def _find_yarns(fabric: Fabric) -> YarnLists | None:
    """Pairs of links between which tension passes, None where none does: their kernel is then not loaded."""
    if fabric.yarns is None or fabric.springs is None:
        return None
    from nuno_kernels.yarns import pack_yarns

    return pack_yarns(fabric.yarns, fabric.springs, fabric.number)


def _find_fused(system: System) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for term in system.terms:
        if term.kind in FUSED:
            if term.kind in found:
                raise BadInput(
                    f"two forces of kind {term.kind!r}",
                    field="contact" if term.kind == "contact" else "forces",
                    limit="one of each kind",
                    remedy="leave one out",
                )
            found[term.kind] = own_copy(term.data)
        elif term.kind not in JOINED:
            raise BadInput(
                f"no kernel for a force of kind {term.kind!r}",
                field="forces",
                limit=f"one of {', '.join((*FUSED, *JOINED))}",
                remedy='use kind "python" with a function f(x, v, t, out)',
            )
    wind = found.pop("wind", None)
    return found if wind is None else found | {"air": wind.air, "wind_runs": wind.runs, "wind_lists": wind.lists}


def own_copy(data: Any) -> Any:
    """A term's tuple with arrays of its own: anchors and scratch belong to one solver's memory. What is read only
    is nobody's.
    """
    return type(data)(*(value.copy() if isinstance(value, np.ndarray) and value.flags.writeable else value
                        for value in data))  # fmt: skip


def python_terms(system: System, start: float, end: float) -> Extra | None:
    """One function that adds all forces written in Python to rows, or None where there are none.

    They are called with x, v (n, 3), the time [s] and `out` (n, 3), to which they add newtons.
    """
    calls: list[Any] = [term.data for term in system.terms if term.kind == "python"]
    if not calls:
        return None

    def extra(x: Float, v: Float, s: float, a: Float) -> None:
        out = np.zeros((x.shape[1], 3))
        position, velocity = np.array(x.T, order="C"), np.array(v.T, order="C")
        for call in calls:
            call(position, velocity, start + s * (end - start), out)
        a += out.T

    return extra
