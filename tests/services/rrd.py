"""What a rerun file holds, by entity."""

from __future__ import annotations

from pathlib import Path
from typing import Any


def columns(path: Path, name: str) -> dict[str, list[Any]]:
    """Rows of a component such as "Points2D:positions", of every entity that has it."""
    import rerun.chunk

    found = dict[str, list[Any]]()
    for chunk in rerun.chunk.RrdReader(path).stream().to_chunks():
        batch = chunk.to_record_batch()
        if name in batch.schema.names:
            found[chunk.entity_path] = batch[name].to_pylist()
    return found
