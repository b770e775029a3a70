"""What all tests share: shipped data from outside, and system packages that may be missing."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import pytest

SHARED = Path(__file__).resolve().parents[1].parent / "shared" / "data"


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """A folder with a real body, a real leg and a captured walk; the test skips without it."""
    if not SHARED.is_dir():
        pytest.skip("no shared data beside the project")
    return SHARED


def need(program: str) -> str:
    """The path of a system program. Without it the test skips by name, but in CI it fails."""
    path = shutil.which(program)
    if path is None:
        message = f"needs the program {program}"
        if os.environ.get("CI"):
            pytest.fail(message)
        pytest.skip(message)
    return path
