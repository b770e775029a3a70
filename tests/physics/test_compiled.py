"""Compiled kernels: kept between runs, called by address, compiled without garbage collection."""

from __future__ import annotations

import gc
import importlib
import logging
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from pkgutil import resolve_name
from typing import Any, NamedTuple

import numba
import numpy as np
import psutil
import pytest
from nets import make_fabric, make_system
from numba.core import event
from numba.core.errors import NumbaError
from numba.core.runtime import _nrt_python, rtsys

import nuno_kernels  # noqa: F401
from nuno_integrators.explicit.fixed_step import ROOM, advance_symplectic_euler
from nuno_integrators.packing import pack
from nuno_kernels import FLAGS, block_kernel, kernel
from nuno_kernels.compilation import internals
from nuno_kernels.compilation.internals import CHECKSUM, Borrowing, keep
from nuno_kernels.compilation.reference import by_reference
from nuno_kernels.compilation.table import memory_of
from nuno_kernels.step.acceleration import add_blocks, evaluate, hold
from nuno_kernels.terms import Terms, over_blocks, register
from nuno_schemas.fabric import Float, Int
from nuno_schemas.system import Term


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
    warnings = [record.getMessage() for record in caplog.records if record.levelno >= logging.WARNING]
    assert warnings == [
        f"compiled kernels cannot be kept in {tmp_path / 'kernels'} (File exists): each run compiles them again"
    ]


def test_a_full_disk_costs_the_keeping_alone(
    compiled: Callable[[], Any], tmp_path: Path, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    kernel = compiled()

    def fail(*arguments: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "write_bytes", fail)
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
        internals._sources.cache_clear()
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


FAR = """\
from __future__ import annotations
from nuno_kernels import block_kernel
@block_kernel
def add(x: float, out) -> None:
    out[0] += x
@block_kernel
def add_twice(x: float, out) -> None:
    add(x, out)
    add(x, out)
@block_kernel
def half(x: float) -> float:
    return x / 2
"""
NEAR = """\
from far import add, add_twice, half
from nuno_kernels import kernel
@kernel
def near(x, out):
    add_twice(x, out)
    add(half(x), out)
"""
SIDE_BY_SIDE = """\
import numpy as np, psutil, sys, time
from nuno_kernels import kernel
from nuno_kernels.compilation import workers
from nuno_kernels.compilation.internals import compiled_here
workers.PATIENCE, workers.cores, workers.idle_cores = -1.0, lambda: 2, lambda: 2
{change}
from near import near
{own}
if {start}:
    workers.WORKERS.compile(("", b""))
    while workers.WORKERS.ready < workers.WORKERS.started:
        time.sleep(0.01)
out = np.zeros(1)
near(2.0, out)
children = [process.pid for process in psutil.Process().children()]
print(out[0], compiled_here()[0], workers.WORKERS.enlisted, *children)
"""


@pytest.fixture
def side_by_side(tmp_path: Path) -> Callable[..., list[str]]:
    """What a program prints that has its kernels compiled by two other processes, from its first kernel on."""
    (tmp_path / "far.py").write_text(FAR)
    (tmp_path / "near.py").write_text(NEAR)

    def run(change: str = "", own: str = "", start: bool = True) -> list[str]:
        given = os.environ | {"PYTHONPATH": str(tmp_path), "XDG_CACHE_HOME": str(tmp_path / "cache")}
        script = SIDE_BY_SIDE.format(change=change, own=own, start=start)
        program = tmp_path / "elsewhere" / "program.py"  # a kernel depends on the sources in its folder
        program.parent.mkdir(exist_ok=True)
        program.write_text(script)
        command = [sys.executable, str(program)]
        return subprocess.run(
            command, env=given, capture_output=True, text=True, check=True, timeout=240
        ).stdout.split()

    return run


def test_other_processes_compile_a_kernel_and_what_it_calls(side_by_side: Callable[..., list[str]]) -> None:
    """Here nothing is compiled; what is called by address is a task of its own; and all is kept for the next process,
    which starts no others.
    """
    assert side_by_side()[:3] == ["5.0", "0", "4"]
    assert side_by_side(start=False) == ["5.0", "0", "0"]


def test_they_end_with_the_process_that_started_them(side_by_side: Callable[..., list[str]]) -> None:
    started = [int(pid) for pid in side_by_side()[3:]]
    assert len(started) == 2
    psutil.wait_procs([psutil.Process(pid) for pid in started if psutil.pid_exists(pid)], timeout=10.0)
    assert not any(psutil.pid_exists(pid) for pid in started)


@pytest.mark.quick(change=["sys.executable = '/nowhere'"])
@pytest.mark.parametrize("change", ["workers.START = 'raise SystemExit'", "sys.executable = '/nowhere'"])
def test_where_they_cannot_work_all_is_compiled_here(change: str, side_by_side: Callable[..., list[str]]) -> None:
    value, compiled, *_ = side_by_side(change)
    assert float(value) == 5.0 and int(compiled) >= 4


@pytest.mark.full
def test_what_they_cannot_import_is_compiled_here(side_by_side: Callable[..., list[str]]) -> None:
    """A kernel of the program itself, or of a notebook; what it calls is theirs."""
    own = "from far import add_twice\n@kernel\ndef near(x, out):\n    add_twice(1.25 * x, out)"
    assert side_by_side(own=own)[:3] == ["5.0", "1", "2"]


def test_one_that_returns_another_type_than_it_says_is_called_by_what_it_returns(
    side_by_side: Callable[..., list[str]], tmp_path: Path
) -> None:
    (tmp_path / "far.py").write_text(FAR.replace("-> float", "-> int"))
    assert [float(side_by_side()[0]), float(side_by_side()[0])] == [5.0, 5.0]


@pytest.mark.parametrize(
    "name",
    [
        "caching:CompileResultCacheImpl.check_cachable",
        "caching:CompileResultCacheImpl.rebuild",
        "caching:CompileResultCacheImpl.reduce",
        "caching:FunctionCache._index_key",
        "caching:FunctionCache.load_overload",
        "caching:FunctionCache.save_overload",
        "codegen:JITCodeLibrary._get_module_for_linking",
        "codegen:JITCodeLibrary._optimize_functions",
        "codegen:JITCodeLibrary.finalize",
        "codegen:JITCPUCodegen._function_pass_manager",
        "compiler:DefaultPassBuilder.define_nopython_pipeline",
        "cpu:CPUContext.insert_user_function",
        "cpu:CPUContext.remove_user_function",
        "dispatcher:Dispatcher.add_overload",
        "dispatcher:Dispatcher.enable_caching",
        "dispatcher:Dispatcher.get_call_template",
        "dispatcher:Dispatcher.get_overload",
        "dispatcher:FunctionCache",
        "event:register",
        "runtime:rtsys.library",
        "serialize:dumps",
        "targetconfig:TargetConfig._values",
        "typing.templates:AttributeTemplate.generic_resolve",
    ],
)
def test_numba_has_what_is_taken_from_its_inside(name: str) -> None:
    """A version of numba that lacks one, or gives it a new name, fails here by that name."""
    resolve_name(f"numba.core.{name}")


class Pair(NamedTuple):
    first: Float
    second: Float


@by_reference
class Lent(NamedTuple):
    """The same by reference, with what else a term may hold."""

    first: Float
    second: Float
    scale: float = 2.0
    on: bool = True
    none: None = None
    inner: tuple[Any, ...] = ()


@kernel
def longer(pair: Pair) -> Float:
    """An array out of two, chosen in a branch, where numba counts."""
    return pair.first if pair.first.shape[0] > pair.second.shape[0] else pair.second


@block_kernel
def borrow(pair: Pair, out: Float) -> None:
    for i in range(out.shape[0]):
        out[i] += longer(pair)[i]


@block_kernel
def make(pair: Pair, out: Float) -> None:
    made = np.full(out.shape[0], 1.0)
    for i in range(out.shape[0]):
        out[i] += made[i] * longer(pair)[i]


@block_kernel
def hand_back(pair: Pair, out: Float) -> Float:
    return longer(pair)


@block_kernel
def make_and_hand_back(pair: Pair) -> Float:
    made = np.empty(pair.first.shape[0])
    made[:] = 1.0
    return made


@block_kernel
def take(pair: Pair, out: Float) -> None:
    """Makes nothing, and has an array all the same."""
    made = make_and_hand_back(pair)
    for i in range(out.shape[0]):
        out[i] += made[i] * longer(pair)[i]


@kernel
def call_all(pair: Pair, out: Float) -> float:
    total = 0.0
    for _ in range(100):
        borrow(pair, out)
        make(pair, out)
        take(pair, out)
        total += hand_back(pair, out)[0]
    return total


@pytest.mark.parametrize("kind", [Pair, Lent])
def test_references_are_as_before_and_nothing_leaks(kind: Any) -> None:
    pair, out = kind(np.arange(8.0), np.arange(5.0)), np.zeros(4)
    assert call_all(pair, out) == 0.0
    np.testing.assert_array_equal(out, 300.0 * np.arange(4.0))
    counts = [sys.getrefcount(one) for one in (*pair[:2], out)]
    _nrt_python.memsys_enable_stats()
    before = rtsys.get_allocation_stats()
    for _ in range(10):
        call_all(pair, out)
    after = rtsys.get_allocation_stats()
    assert after.mi_alloc - before.mi_alloc == after.mi_free - before.mi_free
    assert after.alloc - before.alloc == after.free - before.free
    assert [sys.getrefcount(one) for one in (*pair[:2], out)] == counts
    np.testing.assert_array_equal(pair.first, np.arange(8.0))


@pytest.mark.parametrize(("function", "counts"), [(borrow, False), (make, True), (hand_back, True), (take, True)])
def test_only_what_makes_takes_or_hands_back_arrays_counts(function: Any, counts: bool) -> None:
    """By what is left of numba's counting when all is optimised."""
    fresh = numba.njit(pipeline_class=Borrowing, no_cpython_wrapper=True, **FLAGS)(function.py_func)
    fresh.compile((numba.typeof(Pair(np.zeros(8), np.zeros(5))), numba.typeof(np.zeros(4))))
    (code,) = fresh.inspect_llvm().values()
    assert ("call void @NRT_" in code) == counts


@block_kernel
def read_all(place: int, lent: Lent, out: Float) -> None:
    inner = lent.inner[0]
    if lent.on and lent.none is None:
        out[place] = lent.scale * lent.first[place] + inner.scale * inner.second[place]


read_blocks = over_blocks(read_all, "lent, out")


@kernel
def read_over(lent: Lent, out: Float, threads: int | None) -> None:
    read_blocks(lent, out, out.shape[0], threads)


@pytest.mark.parametrize("threads", [None, 2])
@pytest.mark.parametrize("on", [False, True])
def test_by_reference_all_is_there(on: bool, threads: int | None) -> None:
    """Numbers, what is None and what is within, also where threads read it."""
    first, second = np.random.default_rng(2).random((2, 50))
    out = np.zeros(50)
    read_over(Lent(first, second, 3.0, on, None, (Lent(second, first, 5.0),)), out, threads)
    np.testing.assert_array_equal(out, 3.0 * first + 5.0 * first if on else np.zeros(50))


def test_the_type_by_a_key_is_the_one_that_numba_finds() -> None:
    """Whatever the layout of an array, and whether it may be written, in a tuple of one class."""
    c, locked = np.zeros((4, 4)), np.zeros((4, 4))
    locked.flags.writeable = False
    for first in (c, c.T.copy().T, c[::2], c[:, 1], locked, c.astype(np.int32), c.astype(">f8").view(np.int64)):
        lent = Lent(first, np.zeros(2))
        assert numba.typeof(lent).held.types[0] == numba.typeof(first)
    assert numba.typeof(Lent(c, c, on=False, scale=1)).held.types[2] == numba.typeof(1)  # type: ignore[comparison-overlap]


def test_by_reference_is_one_argument() -> None:
    """In the place of the fourteen numbers that two arrays of one dimension are."""
    arguments = {}
    for kind in (Pair, Lent):
        fresh = numba.njit(pipeline_class=Borrowing, no_cpython_wrapper=True, **FLAGS)(borrow.py_func)
        fresh.compile((numba.typeof(kind(np.zeros(8), np.zeros(5))), numba.typeof(np.zeros(4))))
        ((made,),) = [list(fresh.overloads.values())]
        library = made.library.get_function(made.fndesc.llvm_func_name)
        arguments[kind] = len(list(library.arguments))
    assert arguments[Pair] - arguments[Lent] == 13


class Mixed(NamedTuple):
    """Fields of every size, so that some do not follow each other in memory."""

    on: bool
    small: np.int32
    rate: float
    off: bool
    table: Int
    none: None
    inner: Pair
    deep: tuple[bool, Float, np.float32]
    last: bool


@kernel
def add_mixed(term: Mixed, block: int, origin: int, x: Float, v: Float, force: Float) -> None:
    if term.on and not term.off and term.last and term.deep[0] and term.none is None:
        force[0, 0] += term.rate * term.small + term.table[1, 1] + term.deep[2]
        force[1, 0] += term.inner.first[-1] + term.inner.second.sum()
        force[2, 0] += term.deep[1][1, 0, 2] + term.table.shape[1] + origin


register(Mixed, name="mixed", block=add_mixed)


@kernel
def add_all(terms: Terms, on: Any, x: Float, force: Float, t: float) -> None:
    add_blocks(terms, on, 0, 7, x, x, force, t)


@kernel
def hold_all(terms: Terms, on: Any, x: Float, threads: int | None) -> None:
    hold(terms, on, x, x, 0.0, threads)


def mixed(rate: float = 0.5) -> Mixed:
    inner, deep = Pair(np.arange(3.0), np.arange(5.0)), (True, np.arange(24.0).reshape(2, 3, 4), np.float32(0.25))
    table = np.arange(12, dtype=np.int32).reshape(3, 4)[:, ::2]  # as views have it
    return Mixed(True, np.int32(3), rate, False, table, None, inner, deep, True)


def test_by_a_table_all_of_a_term_is_there() -> None:
    """Of each that acts, wherever its fields lie."""
    terms, x = Terms([mixed(), mixed(2.0), mixed(8.0)], ("block",)), np.zeros((3, 1))
    term, force = terms[0], np.zeros((3, 1))
    add_all(terms, np.array([True, False, True]), x, force, 0.0)
    once = [term.table[1, 1] + 0.25, 2.0 + 10.0, term.deep[1][1, 0, 2] + 2 + 7]
    np.testing.assert_array_equal(force[:, 0], 2.0 * np.array(once) + [8.5 * 3, 0.0, 0.0])


def test_a_role_that_terms_were_not_made_for_is_an_error_and_one_that_they_lack_is_none() -> None:
    x, force, on = np.zeros((3, 1)), np.zeros((3, 1)), np.ones(1, np.bool_)
    with pytest.raises(RuntimeError):
        add_all(Terms([mixed()], ("hold",)), on, x, force, 0.0)
    hold_all(Terms([mixed()], ()), on, x, None)
    assert not force.any()


def test_a_number_that_lies_otherwise_in_memory_is_refused() -> None:
    kind = by_reference(NamedTuple("Kind", [("on", bool), ("value", complex)]))
    with pytest.raises(TypeError, match="complex128"):
        memory_of(numba.typeof(kind(True, 1j)), kind(True, 1j))


def test_terms_of_other_types_compile_no_step_anew() -> None:
    """Nor does another number of them."""
    x, v = np.zeros((2, 3, 1))
    compiled = set[tuple[int, int]]()
    for number in range(3):
        packed = pack(make_system(make_fabric(x.T, mass=1.0), terms=(Term("mixed", (mixed(),) * number),)))
        advance_symplectic_euler(x, v, np.empty((ROOM, 3, 1)), 1, 0.1, packed)
        compiled.add((len(advance_symplectic_euler.overloads), len(evaluate.by_address().overloads)))
    assert len(compiled) == 1


def taking_apart(arrays: int) -> int:
    """Lines of code of a kernel that Python calls with so many arrays by reference."""
    held = by_reference(NamedTuple("Held", [(f"array_{i}", Any) for i in range(arrays)]))  # type: ignore[misc]
    fresh = numba.njit(**FLAGS)(lambda held: 1.0)
    fresh.compile((numba.typeof(held(*[np.zeros(3)] * arrays)),))
    (code,) = fresh.inspect_llvm().values()
    return len(code.splitlines())


def test_python_hands_over_an_array_by_a_few_instructions() -> None:
    """Seven lines, where numba takes twenty and a branch: a system has two hundred arrays."""
    assert taking_apart(40) - taking_apart(20) <= 8 * 20


@pytest.fixture
def looking() -> Iterator[list[bool]]:
    """Whether garbage was looked for, at the start of each compilation and after each."""
    seen: list[bool] = []

    class Watch(event.Listener):  # type: ignore[misc]
        def on_start(self, event: object) -> None:
            seen.append(gc.isenabled())

        def on_end(self, event: object) -> None:
            seen.append(gc.isenabled())

    watch = Watch()
    event.register("numba:compile", watch)
    gc.enable()
    yield seen
    event.unregister("numba:compile", watch)
    gc.enable()


def test_a_compilation_and_those_within_it_are_quiet(looking: list[bool]) -> None:
    inner = numba.njit(lambda x: 2.0 * x)
    assert numba.njit(lambda x: inner(x) + 1.0)(2.0) == 5.0
    assert looking == [False, False, False, True] and gc.isenabled()


def test_one_that_fails_leaves_garbage_to_be_looked_for(looking: list[bool]) -> None:
    with pytest.raises(NumbaError):
        numba.njit(lambda x: x.nothing)(2.0)
    assert gc.isenabled() and not any(looking[:-1])


def test_who_looks_for_none_goes_on_so(looking: list[bool]) -> None:
    gc.disable()
    assert numba.njit(lambda x: 3.0 * x)(2.0) == 6.0
    assert not gc.isenabled() and not any(looking)
