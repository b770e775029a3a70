"""Compiled kernels are kept between runs, and a run does without where they are damaged or cannot be."""

from __future__ import annotations

import importlib
import logging
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numba
import pytest

from nuno_kernels.compile import cache
from nuno_kernels.compile.cache import CHECKSUM, keep


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


@pytest.mark.parametrize("damage", [lambda data: data[: len(data) // 2], lambda data: b"", lambda data: data[::-1]])
def test_a_damaged_file_is_compiled_anew(
    damage: Callable[[bytes], bytes], compiled: Callable[[], Any], tmp_path: Path
) -> None:
    """After a power cut a file may be short or empty, though it was put in its place whole."""
    assert [used(compiled()), used(compiled())] == [0, 1]
    (path,) = tmp_path.rglob("*.nbc")
    path.write_bytes(damage(path.read_bytes()))
    assert [used(compiled()), used(compiled())] == [0, 1]


def test_a_changed_byte_of_machine_code_is_not_run(compiled: Callable[[], Any], tmp_path: Path) -> None:
    assert used(compiled()) == 0
    (path,) = tmp_path.rglob("*.nbc")
    content = bytearray(path.read_bytes())
    content[-CHECKSUM - 100] ^= 1
    path.write_bytes(content)
    assert used(compiled()) == 0


def test_processes_that_compile_at_once_keep_their_own_code(
    compiled: Callable[[], Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Another compiles the kernel for integers when this one, for floats, is about to put its file in place."""
    replace = os.replace

    def replace_after_another(*paths: Any) -> None:
        monkeypatch.setattr(os, "replace", replace)
        assert compiled()(3) == 6
        replace(*paths)

    monkeypatch.setattr(os, "replace", replace_after_another)
    assert used(compiled()) == 0
    last = compiled()
    assert [last(2.5), last(3)] == [5.0, 6] and sum(last.stats.cache_hits.values()) == 2


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


CALLER = """\
import helper
from helper import *
from nuno_kernels import kernel
@{compiler}
def force(x):
    return {body}
"""
HELPERS = {
    "compiled": ("pull(x)", "@numba.njit\ndef pull(x): return {} * x"),
    "by address": ("pull(x)", "from nuno_kernels import block_kernel\n@block_kernel\ndef pull(x): return {} * x"),
    "kept": ("pull(x)", "@numba.njit(cache=True)\ndef pull(x): return {} * x"),
    "shared source": ("pull(x)", "@numba.extending.register_jitable\ndef pull(x): return {} * x"),
    "two calls away": (
        "pull(x)",
        "@numba.njit\ndef drag(x): return {} * x\n@numba.njit\ndef pull(x, law=0): return drag(x)",
    ),
    "attribute": ("helper.pull(x)", "@numba.njit\ndef pull(x): return {} * x"),
    "ufunc": ("pull(x)", "@numba.vectorize\ndef pull(x): return {} * x"),
    "constant": ("K * x", "K = {}.0"),
    "constant by attribute": ("helper.K * x", "K = {}.0"),
    "array": ("K[1] * x", "K = np.array([0.0, {}])"),
    "tuple": ("K[1][0] * x", "K = (0.0, ({}.0,))"),
    "kind": ("K.A.value * x", "import enum\nclass K(enum.IntEnum):\n    A = {}"),
    "closure": (
        "pull(x)",
        "def make(k):\n    @numba.njit\n    def pull(x): return k * x\n    return pull\npull = make({})",
    ),
    "default": ("pull(x)", "@numba.njit\ndef pull(x, k={}): return k * x"),
    "read": ("K * x", "import pathlib\nK = float(pathlib.Path(__file__).with_name('k.txt').read_text())"),
    "overload": (
        "pull(x)",
        "def pull(x): pass\n@numba.extending.overload(pull)\ndef compile_pull(x): return lambda x: {} * x",
    ),
}


class Package:
    """A caller and, in another folder, what it calls."""

    def __init__(self, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        self.folder, self.monkeypatch = folder, monkeypatch
        monkeypatch.setattr(numba.config, "CACHE_DIR", str(folder / "kernels"))
        for name in ("caller", "helper"):
            (folder / name).mkdir()
            monkeypatch.syspath_prepend(str(folder / name))

    def force(self, kind: str, value: int, compiler: str) -> Any:
        """The caller's compiled function as a new process has it."""
        body, helper = HELPERS[kind]
        (self.folder / "helper" / "k.txt").write_text(str(value))
        texts = {"helper": "import numba\nimport numpy as np\n" + helper.replace("{}", str(value))}
        texts["caller"] = "import numba\n" + CALLER.format(compiler=compiler, body=body)
        for name, text in texts.items():
            path = self.folder / name / f"{name}.py"
            if not path.exists() or path.read_text() != text:  # an untouched file keeps its time
                path.write_text(text)
            self.monkeypatch.delitem(sys.modules, name, raising=False)
        self.monkeypatch.setattr(sys, "dont_write_bytecode", True)
        cache._sources.cache_clear()
        importlib.invalidate_caches()
        return importlib.import_module("caller").force


@pytest.mark.parametrize(
    ("kind", "compiler"), [*((kind, "kernel") for kind in HELPERS), ("compiled", "numba.njit(cache=True)")]
)
def test_what_a_kernel_reaches_in_another_module_is_never_stale(
    kind: str, compiler: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The caller's file is untouched, which is all that numba by itself looks at; nothing changed is found kept."""
    package = Package(tmp_path, monkeypatch)
    for value, hits in ((2, 0), (2, 1), (7, 0), (7, 1)):
        force = package.force(kind, value, compiler)
        assert force(1.5) == 1.5 * value
        assert sum(force.stats.cache_hits.values()) == hits


def test_a_kept_kernel_finds_what_it_calls_by_address_in_a_new_process(tmp_path: Path) -> None:
    """Where that was itself kept, and where it is gone and compiled anew: its name is the same."""
    text = "from nuno_kernels import {kinds}\n@{kind}\ndef {name}(x):\n    return {body}\n"
    (tmp_path / "far.py").write_text(text.format(kinds="block_kernel", kind="block_kernel", name="far", body="3.0 * x"))
    near = text.format(kinds="kernel", kind="kernel", name="near", body="far(x) + 1.0")
    (tmp_path / "near.py").write_text("from far import far\n" + near)
    script = "from near import near\nprint(near(2.0), sum(near.stats.cache_hits.values()))"

    def run() -> str:
        given = os.environ | {"PYTHONPATH": str(tmp_path), "XDG_CACHE_HOME": str(tmp_path / "cache")}
        return subprocess.run(
            [sys.executable, "-c", script], env=given, capture_output=True, text=True, check=True
        ).stdout

    assert [run(), run()] == ["7.0 0\n", "7.0 1\n"]
    for path in (tmp_path / "cache").rglob("far.*.nbc"):
        path.unlink()
    assert run() == "7.0 1\n"
