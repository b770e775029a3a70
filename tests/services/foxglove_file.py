"""What is in an MCAP file for Foxglove and Lichtblick, by mcap and its protobuf decoder."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from nuno_schemas.fabric import Float


class Heard(NamedTuple):
    """A message as its reader gives it: log time [ns], and what it says."""

    at: int
    value: Any


def read(path: Path) -> dict[str, list[Heard]]:
    """Messages by topic, each decoded by the schema that the file has of it; JSON as bytes."""
    from mcap.reader import make_reader
    from mcap_protobuf.decoder import DecoderFactory

    factory, found = DecoderFactory(), defaultdict(list)
    with path.open("rb") as stream:
        for schema, channel, message in make_reader(stream, validate_crcs=True).iter_messages():
            decode = factory.decoder_for(channel.message_encoding, schema)
            value = message.data if decode is None else decode(message.data)
            found[channel.topic].append(Heard(message.log_time, value))
    return found


def vectors(points: Any) -> Float:
    return np.array([(p.x, p.y, p.z) for p in points]).reshape(-1, 3)


def turn(q: Any) -> Float:
    """The matrix of a quaternion: the columns are what it makes of the axes, v + 2 w (u x v) + 2 u x (u x v)."""
    u, axes = np.array([q.x, q.y, q.z]), np.eye(3)
    half = np.cross(u, axes)
    return np.asarray((axes + 2.0 * q.w * half + 2.0 * np.cross(u, half)).T)


def placed(known: Mapping[str, tuple[str, Any]], x: Float, frame: str, to: str) -> Float:
    """Points (n, 3) of a frame in another above it, by the parents of frames and where they are in them."""
    while frame != to:
        frame, transform = known[frame]
        x = x @ turn(transform.rotation).T + vectors([transform.translation])
    return x


def known_at(heard: dict[str, list[Heard]], at: int) -> dict[str, tuple[str, Any]]:
    """Frames by the last transforms until a time [ns]."""
    before = (one for topic in ("scene/fixed", "scene/frames") for one in heard[topic] if one.at <= at)
    return {t.child_frame_id: (t.parent_frame_id, t) for one in before for t in one.value.transforms}
