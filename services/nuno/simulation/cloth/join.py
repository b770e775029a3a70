"""Joining of several fabrics into one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from nuno_schemas.fabric import Bending, BendingFriction, Corners, Fabric, Hinges, Membrane, Panels, Springs, Yarns


def join_fabrics(fabrics: list[Fabric], name: str) -> Fabric:
    """Join fabrics in order; a single one is returned unchanged."""
    if len(fabrics) == 1:
        return fabrics[0]
    starts = np.cumsum([0, *(f.number for f in fabrics)])
    moved = list(zip(fabrics, starts, strict=False))
    springs = [replace(f.springs, first=(f.springs.first + at).astype(np.int32)) for f, at in moved if f.springs]
    hinges = [(f.hinges, at) for f, at in moved if f.hinges]
    before = np.cumsum([0, *(f.springs.number if f.springs else 0 for f in fabrics)]).tolist()
    membranes = [replace(f.membrane, faces=f.membrane.faces + np.int32(at)) for f, at in moved if f.membrane]
    bending = [(f.bending.pairs + np.int32(at), f.bending.weight) for f, at in moved if f.bending]
    friction = [replace(f.friction, vertices=f.friction.vertices + np.int32(at)) for f, at in moved if f.friction]
    cells = [f.cells + at for f, at in moved if f.cells is not None]
    yarns = [(f.yarns, at) for f, at in zip(fabrics, before, strict=False) if f.yarns]
    empty, no_uv = np.zeros((0, 3)), np.zeros((0, 2), np.float32)
    return Fabric(
        name,
        np.concatenate([empty, *(f.position for f in fabrics)]),
        np.concatenate([empty, *(f.velocity for f in fabrics)]),
        np.concatenate([np.zeros(0), *(f.mass for f in fabrics)]),
        np.concatenate([np.zeros(0, bool), *(f.pinned for f in fabrics)]),
        np.concatenate([np.zeros((0, 3), np.int32), *((f.faces + at).astype(np.int32) for f, at in moved)]),
        Springs.join(springs) if springs else None,
        _join_hinges(hinges) if hinges else None,
        np.concatenate([no_uv, *(np.zeros((f.number, 2), np.float32) if f.uv is None else f.uv for f in fabrics)]),
        tuple(replace(b, vertices=(b.vertices + at).astype(np.int32)) for f, at in moved for b in f.bindings),
        yarns=Yarns.join(yarns) if yarns else None,
        cells=np.concatenate(cells).astype(np.int32) if cells else None,
        membrane=_join_membranes(membranes) if membranes else None,
        friction=BendingFriction.join(friction) if friction else None,
        corners=_join_corners(moved) if any(f.corners is not None for f in fabrics) else None,
        bending=Bending(*map(np.concatenate, zip(*bending, strict=True))) if bending else None,
    )


def _join_corners(moved: list[tuple[Fabric, np.int64]]) -> Corners:
    """Join corners; a fabric without any has one for each vertex, at its texture coordinates."""
    parts = [f.laid_out or Corners(np.zeros((f.number, 2), np.float32), np.arange(f.number, dtype=np.int32), f.faces)
             for f, _ in moved]  # fmt: skip
    before = np.cumsum([0, *(len(part.vertex) for part in parts)])
    return Corners(
        np.concatenate([part.points for part in parts]),
        np.concatenate([part.vertex + at for part, (_, at) in zip(parts, moved, strict=True)]).astype(np.int32),
        np.concatenate([part.faces + at for part, at in zip(parts, before, strict=False)]).astype(np.int32),
        _join_panels(parts, before.tolist()) if any(part.panels for part in parts) else None,
    )


def _join_panels(parts: list[Corners], before: list[int]) -> Panels:
    """Join panels; triangles of a fabric without panels belong to none."""
    free = np.full((max(len(part.faces) for part in parts), 3), -1, np.int32)
    plain = [Panels((), free[: len(c.faces), 0], free[: len(c.faces)], np.empty(0), free[:0, :2], free[:0, 0])
             for c in parts]  # fmt: skip
    all_ = [part.panels or empty for part, empty in zip(parts, plain, strict=True)]
    names = np.cumsum([0, *(len(panels.names) for panels in all_)]).tolist()
    seams = np.cumsum([0, *(int(panels.seam.max(initial=-1)) + 1 for panels in all_)]).tolist()
    return Panels(
        tuple(name for panels in all_ for name in panels.names),
        np.concatenate([np.where(p.of < 0, -1, p.of + at) for p, at in zip(all_, names, strict=False)]).astype(
            np.int32
        ),
        np.concatenate([panels.edge for panels in all_]),
        np.concatenate([panels.unit for panels in all_]),
        np.concatenate([p.pairs + at for p, at in zip(all_, before, strict=False)]).astype(np.int32),
        np.concatenate([p.seam + at for p, at in zip(all_, seams, strict=False)]).astype(np.int32),
    )


def _join_membranes(parts: list[Membrane]) -> Membrane:
    faces, along, across, area = (
        np.concatenate([getattr(part, name) for part in parts]) for name in ("faces", "along", "across", "area")
    )
    moduli, damping = (np.concatenate([getattr(p, name) for p in parts], axis=1) for name in ("moduli", "damping"))
    return Membrane(faces, along, across, area, moduli, damping)


def _join_hinges(parts: list[tuple[Hinges, int]]) -> Hinges:
    per_run = all(h.k.shape == h.rest.shape == h.count.shape for h, _ in parts)
    values = [(h.k, h.rest) if per_run else (h.per_hinge(h.k), h.per_hinge(h.rest)) for h, _ in parts]
    return Hinges(
        np.concatenate([(h.first + at).astype(np.int32) for h, at in parts]),
        np.concatenate([h.count for h, _ in parts]),
        np.concatenate([h.stride for h, _ in parts]),
        np.concatenate([k for k, _ in values]),
        np.concatenate([rest for _, rest in values]),
    )
