"""USD read back by its own library: what a recording shows at each frame, with prints, panels and bodies."""

from __future__ import annotations

import shutil
import sys
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from exported import picture, png, seen
from PIL import Image
from recorded_sheet import RATE, Sheet, write
from scenes import write_scene

import nuno
from nuno.cli import main
from nuno.exports.cloth import body_vertices, read_bodies, read_pieces
from nuno.exports.usd import export_usd
from nuno.recording.reader import open_recording
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Float

pytest.importorskip("pxr", reason="needs nuno[usd]")
PATTERN = Path(__file__).parents[2] / "scenes" / "sewn" / "patterns" / "top.yaml"
FRAMES = 5
SHEET = Sheet()


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("usd") / "run.mcap"
    write(path, SHEET, FRAMES, {"check.png": png(picture())}, texture="/home/someone/scene/check.png")
    return path


def read(path: Path) -> Any:
    from pxr import Usd

    return Usd.Stage.Open(str(path))


def points(stage: Any, name: str, code: float | None = None) -> Float:
    """(n, 3) of a mesh in the world [m]."""
    from pxr import Usd, UsdGeom

    mesh = UsdGeom.Mesh(stage.GetPrimAtPath(f"/run/{name}"))
    time = Usd.TimeCode.Default() if code is None else Usd.TimeCode(code)
    place = np.array(UsdGeom.Xformable(mesh).ComputeLocalToWorldTransform(time).ExtractTranslation())
    return np.array(mesh.GetPointsAttr().Get(time), float) + place


def test_every_frame_is_where_the_recording_has_it(path: Path, tmp_path: Path) -> None:
    from pxr import UsdGeom, UsdValidation

    out = export_usd(path, tmp_path / "out.usdz")
    stage = read(out)
    assert (stage.GetTimeCodesPerSecond(), stage.GetStartTimeCode(), stage.GetEndTimeCode()) == (RATE, 0, FRAMES - 1)
    assert UsdGeom.GetStageUpAxis(stage) == "Y" and UsdGeom.GetStageMetersPerUnit(stage) == 1.0
    with open_recording(path) as recording:
        bodies = read_bodies(recording)
        for number in range(FRAMES):
            assert np.array_equal(points(stage, "cloth", number), seen(path, number))
            assert points(stage, "bodies", number) == pytest.approx(
                body_vertices(recording, bodies, number / RATE), abs=1e-7
            )
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath("/run/cloth"))
    assert np.array_equal(np.array(mesh.GetFaceVertexIndicesAttr().Get()).reshape(-1, 3), SHEET.faces)
    assert not mesh.GetFaceVertexIndicesAttr().ValueMightBeTimeVarying()
    # What Pixar's own validators say of a package.
    known = UsdValidation.ValidationRegistry().GetOrLoadAllValidators()
    assert [error.GetErrorAsString() for error in UsdValidation.ValidationContext(known).Validate(stage)] == []


def test_the_print_is_in_the_package_and_lies_as_on_the_cloth(path: Path, tmp_path: Path) -> None:
    from pxr import UsdGeom, UsdShade

    out = export_usd(path, tmp_path / "out.usdz")
    stage = read(out)
    prim = stage.GetPrimAtPath("/run/cloth")
    st = UsdGeom.PrimvarsAPI(prim).GetPrimvar("st")
    assert st.GetInterpolation() == "faceVarying"
    assert np.array_equal(np.array(st.ComputeFlattened()).reshape(-1, 3, 2), SHEET.uv[SHEET.faces])
    material, _ = UsdShade.MaterialBindingAPI(prim).ComputeBoundMaterial()
    image = UsdShade.Shader(stage.GetPrimAtPath(f"{material.GetPath()}/image")).GetInput("file").Get()
    assert image.resolvedPath
    with zipfile.ZipFile(out) as archive, archive.open(image.path.removeprefix("./")) as stream:
        assert np.array_equal(np.asarray(Image.open(stream).convert("RGB")), np.asarray(picture()))


def test_one_frame_does_not_move(path: Path, tmp_path: Path) -> None:
    stage = read(export_usd(path, tmp_path / "out.usdz", 3))
    assert np.array_equal(points(stage, "cloth"), seen(path, 3))
    assert not stage.GetPrimAtPath("/run/cloth").GetAttribute("points").ValueMightBeTimeVarying()


def test_panels_are_subsets_and_what_has_no_colour_is_painted_by_stretch(tmp_path: Path) -> None:
    from pxr import UsdGeom

    shutil.copy(PATTERN, tmp_path)
    top = {"plugin": "pattern", "file": "top.yaml", "edge": 0.1}
    objects = [{"name": "my-top", "model": top}, {"name": "my_top", "model": top}]
    scene = write_scene(tmp_path, objects=objects, duration=0.04, view={"colour": "stretch"})
    nuno.run(scene, record=tmp_path / "run.mcap")
    stage = read(export_usd(tmp_path / "run.mcap", tmp_path / "out.usdz"))
    with open_recording(tmp_path / "run.mcap") as recording:
        pieces = read_pieces(recording)
    for piece, name in zip(pieces, ("my_top", "my_top_2"), strict=True):
        mesh = UsdGeom.Mesh(stage.GetPrimAtPath(f"/run/{name}"))
        assert mesh.GetPrim().GetDisplayName() == piece.name
        subsets = UsdGeom.Subset.GetGeomSubsets(mesh, UsdGeom.Tokens.face, "panel")
        assert UsdGeom.Subset.ValidateFamily(mesh, UsdGeom.Tokens.face, "panel")[0]
        assert piece.corners is not None and (panels := piece.corners.panels) is not None
        found = {one.GetPrim().GetDisplayName(): list(one.GetIndicesAttr().Get()) for one in subsets}
        assert found == {name: np.flatnonzero(panels.of == k).tolist() for k, name in enumerate(panels.names)}
        colours = np.array(mesh.GetDisplayColorPrimvar().Get(2))
        assert len(colours) == piece.stop - piece.start and len(np.unique(colours, axis=0)) > 1


def test_what_cannot_be_written_is_said_first(
    path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["export", str(path), "--usd", str(tmp_path / "out.usd")]) == 2
    assert "must end in .usdz" in capsys.readouterr().err
    with pytest.raises(BadInput, match="no such frame") as told:
        export_usd(path, tmp_path / "out.usdz", 99)
    assert told.value.value == 99
    monkeypatch.setitem(sys.modules, "pxr", None)
    assert main(["export", str(path), "--csv", str(tmp_path / "o.csv"), "--usd", str(tmp_path / "out.usdz")]) == 2
    assert 'pip install "nuno[usd]"' in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []
