"""Clips of a GLB file as vertices over time: skins, morph targets and nodes that move (glTF 2.0, 3.11 and C)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from nuno_contact.motions.rotations import slerp
from nuno_contact.motions.vertex_cache import VertexCache, fill_gaps, make_room
from nuno_geometry.mesh_files import glb
from nuno_schemas.errors import BadInput, nearest
from nuno_schemas.fabric import Float
from nuno_schemas.vectors import norm

SAME = 1e-5
"""Keys nearer to each other in time are one [s]."""
MOVES = {"translation": 3, "rotation": 4, "scale": 3, "weights": None}
"""what a channel may move, and how many numbers that is"""
Track = tuple[int, str, tuple[Float, Float, str]]
"""node, what moves of it, and times (k,) [s] and values of its keys, (k, w) or with tangents (k, 3, w), and the kind of
interpolation"""


def read_clips(data: bytes, clips: Sequence[str], mesh: str | None, rate: float) -> VertexCache:
    """Read samples of clips that play together, at the times of all keys, and `rate` times a second [Hz] at least.

    Raises BadInput for an unknown clip or mesh, and as `open_glb` and `read_primitives`.
    """
    document, buffer = glb.open_glb(data)
    nodes = document.get("nodes", [])
    known = {str(one.get("name", f"clip {k}")): one for k, one in enumerate(document.get("animations", ()))}
    clips = _choose_clips(list(known), clips)
    tracks = [track for clip in clips for track in _read_tracks(document, buffer, known[clip])]
    parts = list(glb.read_primitives(document, buffer))
    parents = {child: k for k, node in enumerate(nodes) for child in node.get("children", ())}
    named = [[*(nodes[k].get("name", f"node {k}") for k in glb.way_up(part.node, parents)),
              document["meshes"][nodes[part.node]["mesh"]].get("name", "")] for part in parts]  # fmt: skip
    parts = [_join(parts[k]) for k in choose_named(named, mesh)]
    keys = np.concatenate([np.zeros(0), *(keyed[0] for _, _, keyed in tracks)])
    if not keys.size:
        raise BadInput("the clip moves nothing", field="clip", value=clips, remedy="export it with its keys")
    times = fill_gaps(keys, 1.0 / rate, SAME)
    sampled = [(node, what, _sample(times, *keyed, what == "rotation")) for node, what, keyed in tracks]
    whole = glb.join_parts(parts)
    positions = make_room(len(times), len(whole.points))
    for k in range(len(times)):
        moved = list(nodes)
        for node, what, values in sampled:
            moved[node] = {**moved[node], what: values[k].tolist()}
        world = glb.find_places(moved)
        positions[k] = np.concatenate([part.place(world, moved) for part in parts])
    notes = _left_out(known, clips, {part.node for part in parts})
    return VertexCache(whole.faces, times - times[0], positions, notes=notes)


def _join(part: glb.Part) -> glb.Part:
    """Return a part in which vertices of one place that go together are one: files part them for normals' sake."""
    arrays: dict[str, Any] = {name: getattr(part, name) for name in ("points", "joint", "weight")}
    rows = np.concatenate([*(own for own in arrays.values() if own is not None), *part.targets], axis=1)
    _, first, number = np.unique(rows, axis=0, return_index=True, return_inverse=True)
    kept = np.sort(first)
    arrays = {name: None if own is None else own[kept] for name, own in arrays.items()}
    faces = np.searchsorted(kept, first[number.reshape(-1)])[part.faces]
    return replace(part, **arrays, targets=tuple(target[kept] for target in part.targets), faces=faces)


def _choose_clips(known: list[str], clips: Sequence[str]) -> list[str]:
    """Return the clips of these names, or the only one."""
    if not known:
        remedy = "export it with its animation; a body that stands still: collider: {plugin: mesh, ...} without motion"
        raise BadInput("the file has no clip", field="file", remedy=remedy)
    if not clips and len(known) > 1:
        remedy = f"clip: {known[0]}, or clip: [{known[0]}, {known[1]}], which plays both at once"
        raise BadInput("the file has several clips", field="clip", limit=", ".join(known), remedy=remedy)
    for clip in clips:
        if clip not in known:
            raise BadInput("no such clip", field="clip", value=clip, remedy=nearest(clip, known))
    return list(clips) or known


def _left_out(known: Mapping[str, Any], clips: Sequence[str], nodes: set[int]) -> tuple[str, ...]:
    """Note a clip that alone moves morph targets of the nodes: Blender exports shape keys as clips of their own."""
    moving = [
        name for name, clip in known.items() for target in (channel["target"] for channel in clip["channels"])
        if target["path"] == "weights" and target.get("node") in nodes
    ]  # fmt: skip
    if not moving or not set(moving).isdisjoint(clips):
        return ()
    return (f"its shape keys move in another clip: clip: [{', '.join([*clips, moving[0]])}] plays both",)


def choose_named(named: Sequence[Sequence[str]], mesh: str | None) -> list[int]:
    """Return the numbers of meshes one of whose names, or those of what they hang on, is `mesh`; all without one.

    Raises BadInput where there is none.
    """
    chosen = [k for k, names in enumerate(named) if mesh is None or mesh in names]
    if not chosen:
        remedy = nearest(mesh or "", [names[0] for names in named])
        raise BadInput("the file shows no such mesh", field="mesh", value=mesh, remedy=remedy)
    return chosen


def _read_tracks(document: Any, data: bytes, clip: Any) -> Iterator[Track]:
    for channel in clip["channels"]:
        node, what = channel["target"].get("node"), channel["target"]["path"]
        if node is None or what not in MOVES:
            continue
        sampler = clip["samplers"][channel["sampler"]]
        times, how = glb.read_array(document, data, sampler["input"])[:, 0], sampler.get("interpolation", "LINEAR")
        values = glb.read_array(document, data, sampler["output"])
        values = values.reshape(len(times), *(3,) * (how == "CUBICSPLINE"), -1)
        if not (np.diff(times) > 0.0).all() or MOVES[what] not in (None, values.shape[-1]):
            raise ValueError(f"keys of node {node} that are no {what}, or whose times do not increase")
        yield node, what, (times, values, how)


def _sample(at: Float, times: Float, values: Float, how: str, turns: bool) -> Float:
    """Return a track's values (m, w) at times (m,) [s], which are held before its first key and after its last."""
    k = np.clip(np.searchsorted(times, at, side="right") - 1, 0, max(len(times) - 2, 0))
    after, dt = np.minimum(k + 1, len(times) - 1), np.append(np.diff(times), 1.0)[k]
    s = np.clip((at - times[k]) / dt, 0.0, 1.0)[:, None]
    if how == "STEP":
        return np.asarray(np.where(s < 1.0, values[k], values[after]))
    if how == "LINEAR":
        one, other = values[k], values[after]
        return slerp(one, other, s) if turns else np.asarray((1.0 - s) * one + s * other)
    (_, one, out), (into, other, _) = values[k].swapaxes(0, 1), values[after].swapaxes(0, 1)
    mixed = (2.0 * s**3 - 3.0 * s**2 + 1.0) * one + (3.0 * s**2 - 2.0 * s**3) * other
    mixed += dt[:, None] * ((s**3 - 2.0 * s**2 + s) * out + (s**3 - s**2) * into)
    return np.asarray(mixed / norm(mixed)[:, None] if turns else mixed)
