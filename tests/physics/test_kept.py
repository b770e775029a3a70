"""Compiled kernels are kept between runs, and a run does without where they are damaged or cannot be."""

from __future__ import annotations

import logging
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numba
import pytest

from nuno_kernels.kept import CHECKSUM, keep


def twice(x: float) -> float:
    return 2.0 * x


@pytest.fixture
def compiled(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[], Any]:
    """The kernel as a new process has it."""
    folder = tmp_path / "kernels"
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(folder))
    return lambda: keep(numba.njit(nogil=True)(twice), folder)


def used(kernel: Any) -> int:
    """How often a call finds the kernel kept."""
    assert kernel(2.5) == 5.0
    return sum(kernel.stats.cache_hits.values())


@pytest.mark.parametrize("suffix", ["nbi", "nbc"])
@pytest.mark.parametrize("damage", [lambda data: data[: len(data) // 2], lambda data: b"", lambda data: data[::-1]])
def test_a_damaged_file_is_compiled_anew(
    suffix: str, damage: Callable[[bytes], bytes], compiled: Callable[[], Any], tmp_path: Path
) -> None:
    """After a power cut a file may be short or empty, though it was put in its place whole."""
    assert [used(compiled()), used(compiled())] == [0, 1]
    (path,) = tmp_path.rglob(f"*.{suffix}")
    path.write_bytes(damage(path.read_bytes()))
    assert [used(compiled()), used(compiled())] == [0, 1]


def test_a_changed_byte_of_machine_code_is_not_run(compiled: Callable[[], Any], tmp_path: Path) -> None:
    assert used(compiled()) == 0
    (path,) = tmp_path.rglob("*.nbc")
    content = bytearray(path.read_bytes())
    content[-CHECKSUM - 100] ^= 1
    path.write_bytes(content)
    assert used(compiled()) == 0


def test_a_folder_that_cannot_be_made_costs_the_keeping_alone(
    compiled: Callable[[], Any], tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """Not elsewhere: beside the sources kernels go stale when a function that they call changes."""
    (tmp_path / "kernels").write_text("in the way")
    with caplog.at_level(logging.WARNING, "nuno.kernels"):
        kernel = compiled()
    assert used(kernel) == 0 and used(compiled()) == 0
    assert [record.getMessage() for record in caplog.records] == [
        f"compiled kernels cannot be kept in {tmp_path / 'kernels'} (File exists): each run compiles them again"
    ]


def test_a_full_disk_costs_the_keeping_alone(
    compiled: Callable[[], Any], tmp_path: Path, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    kernel = compiled()

    def fail(*arguments: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(kernel._cache._cache_file, "save", fail)
    assert used(kernel) == 0
    assert "No space left on device" in caplog.text
