"""What is refused, and how tests ask for it."""

from __future__ import annotations

import resource
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scenes import write_scene

from nuno.cli import main


@contextmanager
def largest_file(size: int) -> Iterator[None]:
    """The system refuses to let any file of this process grow beyond `size` bytes."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


def sheet(**fields: Any) -> list[dict[str, Any]]:
    return [{"name": "cloth", "model": {"plugin": "sheet", "resolution": [4, 4]} | fields}]


def of_file(name: str, plugin: str = "net") -> list[dict[str, Any]]:
    return [{"name": "cloth", "model": {"plugin": plugin, "file": name}}]


def write_net(path: Path, number: int = 3, **changed: Any) -> None:
    """A straight net of two springs, with any array replaced."""
    arrays: dict[str, Any] = {
        "x": np.arange(number)[:, None] * np.array([1.0, 0.0, 0.0]),
        "v": np.zeros((number, 3)),
        "m": np.ones(number),
        "pinned": np.arange(number) == 0,
        "springs": np.array([[0, 1], [1, 2]]),
        "k": np.ones(2),
        "rest": np.ones(2),
        "c": np.zeros(2),
    }
    np.savez(path, **(arrays | changed))


class Refused:
    """What a command printed."""

    def __init__(self, capfd: pytest.CaptureFixture[str], folder: Path) -> None:
        self.capfd, self.folder = capfd, folder

    def __call__(self, *command: object, code: int = 2) -> str:
        """Run a command that must end with `code`, without a trace; what it said."""
        self.capfd.readouterr()
        assert main([str(part) for part in command]) == code
        said = self.capfd.readouterr().err
        assert "Traceback" not in said
        assert "error:" in said if code == 2 else said
        return said

    def run(self, *flags: object, code: int = 2, **fields: Any) -> str:
        """Run a scene that must be refused; nothing may be left that looks like a recording."""
        scene = write_scene(self.folder, **fields)
        record = self.folder / "out" / "run.mcap"
        said = self("run", scene, "--no-view", "--record", record, *flags, code=code)
        assert not record.parent.exists() or list(record.parent.iterdir()) == []
        return said
