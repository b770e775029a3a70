"""What a rerun file holds, by entity."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

from viewer_run import Fed

from nuno.viewer.file import RerunFile
from nuno.viewer.stream import Subject


def columns(path: Path, name: str) -> dict[str, list[Any]]:
    """Rows of a component such as "Points2D:positions", of every entity that has it."""
    import rerun.chunk

    found = dict[str, list[Any]]()
    for chunk in rerun.chunk.RrdReader(path).stream().to_chunks():
        batch = chunk.to_record_batch()
        if name in batch.schema.names:
            found.setdefault(chunk.entity_path, []).extend(batch[name].to_pylist())
    return found


def write_all(file: RerunFile, fed: Iterable[Fed]) -> Path:
    for message in fed:
        file.feed(*message)
    return file.finish()


def write(path: Path, fed: Iterable[Fed]) -> Path:
    return write_all(RerunFile(path, Subject(run="run")), fed)


def read(path: Path, entity: str, column: str, static: bool = False) -> dict[int, Any]:
    """The column's values by frame number (0 for static ones)."""
    import rerun.chunk

    found: dict[int, Any] = {}
    for chunk in rerun.chunk.RrdReader(path).stream().to_chunks():
        batch = chunk.to_record_batch()
        if chunk.entity_path == entity and chunk.is_static == static and column in batch.schema.names:
            frames = [0] * len(batch) if static else batch["frame"].to_pylist()
            found |= {f: v for f, v in zip(frames, batch[column].to_pylist(), strict=True) if v is not None}
    return found


def curves(path: Path, plot: str) -> dict[str, dict[int, float]]:
    """Values of a plot's curves, "/plots/energy", by name and frame number."""
    import rerun.chunk

    chunks = rerun.chunk.RrdReader(path).stream().to_chunks()
    names = {chunk.entity_path.removeprefix(f"{plot}/") for chunk in chunks if chunk.entity_path.startswith(f"{plot}/")}
    return {
        name.replace("\\", ""): {n: v[0] for n, v in read(path, f"{plot}/{name}", "Scalars:scalars").items()}
        for name in names
    }
