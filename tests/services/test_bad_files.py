"""Files that a scene names and that cannot be used, or must not be."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from refusals import Refused, of_file, write_net
from scenes import write_scene

from nuno.cli import main
from nuno.scene import scene_file

NETS: dict[str, tuple[dict[str, Any], str]] = {
    "nan": ({"x": np.full((3, 3), np.nan)}, "x[0, 0]: not a finite number"),
    "inf": ({"v": np.full((3, 3), np.inf)}, "v[0, 0]: not a finite number"),
    "zero mass": ({"m": np.array([1.0, 0, 1])}, "m[1]: a mass must be positive"),
    "negative mass": ({"m": np.array([1.0, 1, -1])}, "m[2]: a mass must be positive"),
    "spring to itself": ({"springs": np.array([[0, 1], [2, 2]])}, "springs[1]: a spring from a vertex to itself"),
    "index too large": ({"springs": np.array([[0, 1], [1, 3]])}, "springs[1, 1]: no such vertex"),
    "index -1": ({"springs": np.array([[0, 1], [1, -1]])}, "springs[1, 1]: no such vertex"),
    "duplicate": ({"springs": np.array([[0, 1], [1, 0]])}, "springs[1]: the same two vertices as springs[0]"),
    "unknown key": ({"masses": np.ones(3)}, "masses: unknown array"),
}


@pytest.mark.parametrize("fault", NETS)
def test_bad_nets_name_file_place_and_who_named_them(fault: str, refused: Refused, tmp_path: Path) -> None:
    change, words = NETS[fault]
    write_net(tmp_path / "bad.npz", **change)
    said = refused.run(objects=of_file("bad.npz"))
    assert f"{tmp_path / 'bad.npz'}: {words}" in said
    assert f"{tmp_path / 'scene.yaml'}:" in said


FILES: dict[str, tuple[str, str, bytes | None, str]] = {
    "missing net": ("net", "bad.npz", None, "no such file"),
    "empty net": ("net", "bad.npz", b"", "not a readable .npz file"),
    "truncated net": ("net", "bad.npz", b"PK\x03\x04" + b"\0" * 50, "not a readable .npz file"),
    "missing mesh": ("mesh", "bad.obj", None, "no such file"),
    "empty mesh": ("mesh", "bad.obj", b"", "the mesh has no triangles"),
    "noise for a mesh": ("mesh", "bad.ply", bytes(range(256)) * 4, "cannot be read as PLY"),
    "mesh that promises too much": (
        "mesh", "bad.ply", b"ply\nformat binary_little_endian 1.0\nelement vertex 99999999999\n"
        b"property float x\nproperty float y\nproperty float z\nend_header\n", "cannot be read as PLY",
    ),
    "mesh of another kind": ("mesh", "bad.docx", b"x", "unknown kind of mesh"),
    "name with a NUL": ("net", "a\0b", None, "not the name of a file"),
    "name too long": ("net", "a" * 5000, None, "not the name of a file"),
    "empty name": ("net", "", None, "no such file"),
    "folder": ("net", ".", None, "no such file"),
}  # fmt: skip


@pytest.mark.parametrize("fault", FILES)
def test_files_that_cannot_be_used(fault: str, refused: Refused, tmp_path: Path) -> None:
    plugin, name, content, words = FILES[fault]
    if content is not None:
        (tmp_path / name).write_bytes(content)
    said = refused.run(objects=of_file(name, plugin))
    assert words in said
    assert f"{tmp_path / 'scene.yaml'}:" in said
    assert "objects[0].model" in said


@pytest.fixture
def outside(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder that is not the scene's, with a net."""
    folder = tmp_path_factory.mktemp("outside")
    write_net(folder / "net.npz")
    return folder


@pytest.mark.parametrize("how", ["relative", "absolute", "link", "link to itself"])
def test_paths_that_leave_the_folder(how: str, refused: Refused, tmp_path: Path, outside: Path) -> None:
    names = {
        "relative": os.path.relpath(outside / "net.npz", tmp_path),
        "absolute": str(outside / "net.npz"),
        "link": "link.npz",
        "link to itself": "loop.npz",
    }
    (tmp_path / "link.npz").symlink_to(outside / "net.npz")
    (tmp_path / "loop.npz").symlink_to(tmp_path / "loop.npz")
    said = refused.run(objects=of_file(names[how]))
    assert "objects[0].model.file" in said
    if how != "link to itself":
        assert "leaves the scene's folder" in said
        assert (f"to {outside / 'net.npz'}" in said) is (how == "link")
        assert (f"--root {outside}" if how == "link" else "--root DIR") in said
        assert str(tmp_path) in said


def test_a_link_may_lead_into_a_folder_that_the_user_names(tmp_path: Path, outside: Path) -> None:
    """As its remedy says, whatever the file is called there."""
    (tmp_path / "other.npz").symlink_to(outside / "net.npz")
    scene = write_scene(tmp_path, objects=of_file("other.npz"), duration=0.1)
    loaded = scene_file.read(scene, [], [outside])
    assert loaded.files.resolve("other.npz") == (outside / "net.npz").resolve()


def test_a_root_opens_its_folder_and_no_other(refused: Refused, tmp_path: Path, outside: Path) -> None:
    command = ["run", write_scene(tmp_path, objects=of_file("net.npz"), duration=0.1), "--no-view", "--no-record"]
    assert main([*map(str, command), "--root", str(outside)]) == 0
    (outside / "link.npz").symlink_to("/etc/passwd")
    for name in ("../secret.npz", "/etc/passwd", "link.npz"):
        said = refused.run("--root", outside, objects=of_file(name))
        assert "leaves the scene's folder" in said or "no such file" in said
        assert str(outside) in said
    assert "--root: no such folder" in refused.run("--root", tmp_path / "nowhere")
