"""What a killed process has left is taken away by the next one, and what a living one holds is not."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from recorded_sheet import Sheet, write

from nuno import process as scratches
from nuno.cli import main
from nuno.process import HIDDEN, PREFIX, scratch
from nuno.runtime.log import written
from nuno_schemas.errors import BadInput

CHILD = """
import sys, time
from pathlib import Path
from nuno import process as scratch
from nuno.runtime.log import written
with scratch.scratch(Path(sys.argv[1]) if sys.argv[1] else None) as folder, written("run", Path(sys.argv[2])):
    (folder / "file").write_text("data")
    print(folder, flush=True)
    time.sleep(60)
"""


@contextmanager
def _child(beside: Path | None, log: Path) -> Iterator[tuple[Path, subprocess.Popen[str]]]:
    """A process that has a scratch folder, and a log that no service has made ready."""
    words = [sys.executable, "-c", CHILD, str(beside or ""), str(log)]
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as child:
        assert child.stdout is not None
        try:
            yield Path(child.stdout.readline().strip()), child
        finally:
            child.kill()


@pytest.mark.parametrize("beside", [False, True])
def test_what_a_killed_process_left_goes_and_what_is_held_stays(
    tmp_path: Path, beside: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(scratches, "YOUNG", 0.0)
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    log, where = tmp_path / "a.log.jsonl", tmp_path if beside else None
    with _child(where, log) as (folder, child):
        assert folder.parent == tmp_path and folder.name.startswith(HIDDEN if beside else PREFIX)
        with scratch(where), written("other", tmp_path / "b.log.jsonl"):
            assert (folder / "file").is_file()
        child.kill()
        child.wait()
        assert folder.is_dir()
        with scratch(where), written("other", tmp_path / "b.log.jsonl"):
            assert not folder.exists()
    assert not list(tmp_path.iterdir())


@pytest.fixture
def sheet(tmp_path: Path) -> Path:
    write(tmp_path / "a.mcap", Sheet(3, 2), 4)
    return tmp_path / "a.mcap"


def test_a_failed_export_of_frames_leaves_nothing(sheet: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Neither a folder that it has made, nor the frames before the one that fails; one that was there stays."""

    def fail(done: int, total: int) -> None:
        if done == 3:
            raise BadInput("enough")

    monkeypatch.setattr("nuno.cli.export.show_progress", fail)
    before = set(sheet.parent.iterdir())
    assert main(["export", str(sheet), "--obj", str(sheet.parent / "frames")]) == 2
    assert set(sheet.parent.iterdir()) == before
    (sheet.parent / "frames").mkdir()
    assert main(["export", str(sheet), "--obj", str(sheet.parent / "frames")]) == 2
    assert list((sheet.parent / "frames").iterdir()) == []


def test_a_whole_export_takes_away_what_a_killed_one_left(sheet: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scratches, "YOUNG", 0.0)
    frames = sheet.parent / "frames"
    (frames / f"{HIDDEN}left").mkdir(parents=True)
    (frames / f"{HIDDEN}left" / "frame_00000.obj").write_text("# nuno")
    assert main(["export", str(sheet), "--obj", str(frames)]) == 0
    assert sorted(path.name for path in frames.iterdir()) == [f"frame_0000{i}.obj" for i in range(4)]
