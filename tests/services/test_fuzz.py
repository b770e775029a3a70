"""What fuzzing found, each input as short as it can be; and a few hundred changed inputs of every kind."""

from __future__ import annotations

import io
import json
import zipfile
from pathlib import Path
from random import Random
from typing import Any

import numpy as np
import pytest

from nuno.bus.encodings import BadMessage, decode_arrays, encode_arrays
from nuno.collision.messages import decode_geometry, encode_geometry
from nuno.plugin_contract import registry
from nuno.plugin_contract.values import ContractError, check_field
from nuno.recording.mcap_file import McapFile
from nuno.recording.reader import END, Recording
from nuno.scene.files import SceneFiles
from nuno_geometry.mesh_files.mesh import load_mesh
from nuno_schemas import SCHEMA_VERSION
from nuno_schemas.bodies import FIELD, DistanceField, Geometry
from nuno_schemas.errors import BadInput
from soak.fuzz import KINDS
from soak.fuzz.files import BVH
from soak.fuzz.worker import Trial

PATIENCE = 600.0
"""Processor time [s] after which an input is broken off: kernels may have to be compiled."""
INPUTS = 25
"""Of each kind; the part `fuzz` of `make soak` tries a hundred thousand, guided by the lines they reach."""


@pytest.mark.full
@pytest.mark.parametrize("name", KINDS)
def test_changed_inputs_are_accepted_whole_or_refused_in_words(name: str, tmp_path: Path) -> None:
    kind, random = KINDS[name], Random(1)
    seeds, read = kind.seeds(tmp_path), kind.reader(tmp_path)
    trial = Trial(read, kind.refusals, tmp_path, PATIENCE)
    for data in seeds:
        trial.one(data)
    for _ in range(INPUTS):
        trial.one(kind.mutate(random.choice(seeds), random)[: kind.longest])
    # How long it takes, and in how much memory, is for the long test: here kernels may be compiled.
    found = {place: said for place, said in trial.found.items() if place not in ("slow", "memory")}
    assert (found, trial.crashes) == ({}, 0)
    assert trial.accepted > 0


def _refused(name: str, data: bytes, folder: Path) -> str:
    with pytest.raises(BadInput) as refusal:
        KINDS[name].reader(folder)(data)
    return str(refusal.value)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        (b"Frame Time: 0.0333333", b"Frame Time: 1e-9", "no time between two frames"),
        (b"Frame Time: 0.0333333", b"Frame Time: nan", "BVH|no time between two frames"),
        (b"OFFSET 0 -1 0.1", b"OFFSET 0 -1 1e300", "a body of no size"),
        (b"0 2 0.1 0", b"1e305 2 0.1 0", "a body of no size"),
    ],
)
def test_motions_of_no_size_or_pace(old: bytes, new: bytes, words: str, tmp_path: Path) -> None:
    assert any(word in _refused("BVH", BVH.replace(old, new), tmp_path) for word in words.split("|"))


def test_a_face_of_a_vertex_that_is_not_there(tmp_path: Path) -> None:
    (tmp_path / "a.obj").write_bytes(b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n")
    files = SceneFiles(tmp_path)
    for group in ("nuno.models", "nuno.colliders"):
        plugin = registry.load(group, "mesh")
        with pytest.raises(BadInput, match="cannot be read as OBJ"):
            plugin.build(plugin.Config(file="a.obj"), *(() if group == "nuno.models" else (None,)), files,
                         *((0,) if group == "nuno.models" else ()))  # fmt: skip


def _packed(change: Any = None, how: int = zipfile.ZIP_STORED, **extra: bytes) -> bytes:
    """The first net that inputs are made from, with members of other bytes, packed otherwise."""
    stream = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(KINDS["npz of a net"].seeds(Path())[0])) as old:
        parts = {member: old.read(member) for member in old.namelist()} | extra
    with zipfile.ZipFile(stream, "w", how) as new:
        for member, data in parts.items():
            new.writestr(member, data)
    return change(stream.getvalue()) if change else stream.getvalue()


def _flagged(data: bytes) -> bytes:
    """The first member is said to be patched data (flag bit 5), in the directory and before itself."""
    found = bytearray(data)
    found[6] |= 0x20
    at = data.index(b"PK\x01\x02")
    found[at + 8] |= 0x20
    return bytes(found)


def _version(data: bytes) -> bytes:
    at = data.index(b"PK\x01\x02")
    return data[: at + 6] + b"\xff\x00" + data[at + 8 :]


def _header(text: bytes) -> bytes:
    return b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text


NETS = {
    "flag": (lambda: _packed(_flagged), "not a numpy array"),
    "version": (lambda: _packed(_version), "not a readable .npz file"),
    "bzip2": (lambda: _packed(how=zipfile.ZIP_BZIP2), "packed in a way that no array is"),
    "no array": (lambda: _packed(x=b"1"), "two arrays of one name, or no array"),
    "bomb": (lambda: _packed(how=zipfile.ZIP_DEFLATED, **{"x.npy": bytes(10**6)}), "not a numpy array"),
    "header": (lambda: _packed(**{"x.npy": _header(b"{'descr': (\n")}), "not a numpy array"),
    "shape": (
        lambda: _packed(**{"x.npy": _header(b"{'descr': '<f8', 'fortran_order': False, 'shape': (True, 3), }\n")}),
        "not a numpy array: a shape of",
    ),
    "objects": (
        lambda: _packed(**{"x.npy": _header(b"{'descr': '|O', 'fortran_order': False, 'shape': (1, 3), }\n")}),
        "wrong dtype",
    ),
}  # fmt: skip


@pytest.mark.parametrize("fault", NETS)
def test_archives_that_are_none(fault: str, tmp_path: Path) -> None:
    make, words = NETS[fault]
    assert words in _refused("npz of a net", make(), tmp_path)


def test_lines_that_are_no_lines(tmp_path: Path) -> None:
    said = _refused("OBJ of lines", b"v 0 0 0\nv 1 nan 0\nl 1 2\n", tmp_path)
    assert "input.obj:2: file: cannot be read as OBJ: not a finite position" in said
    (tmp_path / "none.obj").write_bytes(b"v 0 0 0\n")
    plugin = registry.load("nuno.operations", "wrinkle")
    lines = [{"points": [[0, 0, 0], [1, 0, 0]], "height": 0.01}, {"file": "none.obj", "height": 0.01}]
    with pytest.raises(BadInput, match="the file holds no lines"):
        plugin.resolve(plugin.Config(lines=lines), SceneFiles(tmp_path))


@pytest.mark.parametrize("number", ["1" + "0" * 400, "1e400", "null", "[]"])
@pytest.mark.parametrize(
    ("name", "field"), [("collision/bodies", "t"), ("dye/cloth", "cell_size"), ("sim/fabric", "vertices")]
)
def test_messages_with_numbers_that_are_none(name: str, field: str, number: str, tmp_path: Path) -> None:
    kind = KINDS[f"message {name}"]
    arrays, text = decode_arrays(kind.seeds(tmp_path)[0])
    text = json.loads(json.dumps(text | {field: None}).replace(f'"{field}": null', f'"{field}": {number}'))
    with pytest.raises(BadMessage):
        kind.reader(tmp_path)(encode_arrays(arrays, text))


def test_cloth_with_a_vertex_beyond_all_reckoning(tmp_path: Path) -> None:
    (tmp_path / "far.stl").write_text(
        "solid\nfacet\nouter loop\nvertex 1e308 1e-320 11\nvertex -1 -1 0.5\nvertex 1 0 0\n"
        "endloop\nendfacet\nendsolid\n"
    )
    plugin = registry.load("nuno.models", "mesh")
    with pytest.raises(BadInput, match="vertex 0: too far away"):
        plugin.build(plugin.Config(file="far.stl"), SceneFiles(tmp_path), 0)


def test_a_number_too_long_to_be_read_is_no_field_that_can_change(tmp_path: Path) -> None:
    KINDS["question control"].reader(tmp_path)(json.dumps({"action": "set", "item": f"solver.{'9' * 5000}=1"}).encode())


@pytest.mark.parametrize(
    ("face", "height", "words"), [("9" * 300, "-0.01", "this is no line"), ("1", "1e-9", "a line of no height")]
)
def test_strokes_of_the_page_that_are_none(face: str, height: str, words: str, tmp_path: Path) -> None:
    line = f'{{"points": [[0, 0.3, 0], [{face}, 0.3, 0.3]], "height": {height}}}'
    for does in ("check", "export"):
        request = f'{{"do": "draw", "does": "{does}", "start": 1, "lines": [{line}]}}'
        assert words in _refused("page request", request.encode(), tmp_path)


@pytest.mark.parametrize(
    "face", ["1/1/1 2/1/1 247483649/4/1", "1/1 2/2 -247483649/3", "00000000001/1 2/2 3\\\n00000000/3"]
)
def test_room_is_not_made_for_vertices_that_a_triangle_alone_knows(face: str, tmp_path: Path) -> None:
    """A reader that takes some bytes for each number up to the largest runs out of them."""
    (tmp_path / "a.obj").write_text(f"v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nf {face}\n")
    with pytest.raises(BadInput, match="a triangle of a vertex that is not there") as refused:
        load_mesh(tmp_path / "a.obj", ("obj",))
    assert refused.value.line == 5


def test_numbers_of_vertices_may_begin_with_noughts(tmp_path: Path) -> None:
    (tmp_path / "a.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 00000000001 2 \\\n000003\n")
    assert load_mesh(tmp_path / "a.obj", ("obj",)).faces.tolist() == [[0, 1, 2]]


def test_an_object_of_vertices_that_are_not_there_is_not_made_room_for(tmp_path: Path) -> None:
    kind = KINDS["message sim/fabric"]
    arrays, text = decode_arrays(kind.seeds(tmp_path)[0])
    text["objects"][0]["stop"] = 10**12
    with pytest.raises(BadMessage, match="an object of vertices 0 to 1000000000000 of 4"):
        kind.reader(tmp_path)(encode_arrays(arrays, text))


def test_a_report_that_nests_too_deep(tmp_path: Path) -> None:
    with pytest.raises(BadMessage):
        KINDS["message run/report"].reader(tmp_path)(b'{"a":' * 100_000)


def _geometry(**changed: Any) -> Geometry:
    one = np.zeros(1, np.int32)
    field = DistanceField(np.zeros(3), 1.0, np.ones(3, np.int32), 0.1, 1.0, np.full(1, -1, np.int32),
                          np.zeros((1, 32), np.float32))  # fmt: skip
    given: dict[str, Any] = {
        "kind": np.full(1, FIELD, np.int8), "frame": one, "body": one, "a": np.zeros((1, 3)), "b": np.ones((1, 3)),
        "radius": np.zeros(1), "stiffness": np.full(1, np.nan), "damping": np.zeros(1), "friction": np.zeros(1),
        "vertices": np.eye(3), "faces": np.arange(3, dtype=np.int32)[None], "owner": one, "fields": (field,),
    }  # fmt: skip
    return Geometry(("a",), ("a/world",), **(given | changed))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({}, ""),
        ({"faces": np.array([[0, 1, 3]], np.int32)}, "faces is 3 at row 0, outside 0 to 2"),
        ({"owner": np.full(1, -1, np.int32)}, "owner is -1 at row 0, outside 0 to 0"),
        ({"frame": np.ones(1, np.int32)}, "frame is 1 at row 0, outside 0 to 0"),
        ({"a": np.zeros((1, 2))}, "a is float64"),
        ({"radius": np.zeros(1, np.int64)}, "radius is int64"),
    ],
)
def test_bodies_that_kernels_would_read_beyond(change: dict[str, Any], words: str) -> None:
    payload = encode_geometry(_geometry(**change))
    if not words:
        assert len(decode_geometry(payload).kind) == 1
        return
    with pytest.raises(BadMessage, match=words):
        decode_geometry(payload)


@pytest.mark.parametrize("child", [[0] + [-1] * 8, [2] + [-1] * 8, [-2], [1]])
def test_distance_fields_that_lead_nowhere(child: list[int]) -> None:
    field = DistanceField(np.zeros(3), 1.0, np.ones(3, np.int32), 0.1, 1.0, np.array(child, np.int32),
                          np.zeros((1, 32), np.float32))  # fmt: skip
    with pytest.raises(ContractError, match="lead nowhere"):
        check_field("fields[0]", field)


def test_recordings_of_what_no_run_records(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    with path.open("wb") as stream:
        file = McapFile(stream)
        file.add_metadata("run", {"run": "a", "schema_version": str(SCHEMA_VERSION)})
        file.add_metadata(END, {"missing": '{"sim/state": [1]}'})
        channel = file.add_channel("sim/status", "json", "nuno.Status", "jsonschema", b"{}")
        file.add_message(channel, 0, 0, 0, b'{"frame": null}')
        file.finish()
    with Recording(path) as recording:
        with pytest.raises(BadInput, match="no numbers of messages"):
            _ = recording.missing
        for read in (recording.marks, recording.series):
            with pytest.raises(BadInput, match="sim/status 0 at 0 s: not a nuno"):
                read()
