"""A fabric from a laboratory's sheet, and the page of all fabrics."""

from __future__ import annotations

import base64
import io
import re
from html import unescape
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from PIL import Image

from nuno.cli import main
from nuno.cli.textiles import digits, find_presets
from nuno.plugin_contract import registry
from nuno.scene.templates import import_sheet, read_values
from nuno_bench.fabric_tests import sheet, specimens, swatches
from nuno_bench.fabric_tests.sheet import cells, find_fabric
from nuno_bench.sweep.executor import Executor
from nuno_cloth.fabrics.laboratory import SHEETS, UNUSED
from nuno_schemas.errors import BadInput
from nuno_schemas.preset import Imported

KES = "instrument: KES-F\nW: 12.1\nB: [0.118, 0.076]\n2HB: 0.124\nG: [0.8, 0.7]\nLT: [0.8, 1.0]\nEMT: [3.2, 6.1]\n"
FAST = "instrument: FAST\nW: 200\nC: [20, 16]\nE5: [0.5, 1.2]\nEB5: 4.1\n"


def read(folder: Path, text: str, like: str | None = None, suffix: str = ".yaml") -> Imported:
    path = folder / f"sheet{suffix}"
    path.write_text(text)
    found: Imported = registry.load("nuno.models", "sheet").import_fabric(read_values(path)[0], like, folder)
    return found


def import_text(folder: Path, text: str, suffix: str = ".csv") -> None:
    (folder / f"sheet{suffix}").write_text(text)
    import_sheet(folder / f"sheet{suffix}", None)


def test_kes_values_are_read_in_their_units(tmp_path: Path) -> None:
    """1 gf cm^2/cm is 98.07 uN m, 1 gf/(cm deg) 56.19 N/m; a curve of LT = 1 is straight, 490.3 N/m over EMT."""
    found = read(tmp_path, KES)
    assert found.fabric["density"] == pytest.approx(0.121, rel=1e-12)
    assert found.fabric["bend_warp"] == pytest.approx(0.118 * 98.0665e-6, rel=1e-9)
    assert found.fabric["bend_weft"] == pytest.approx(0.076 * 98.0665e-6, rel=1e-9)
    assert found.fabric["shear"] == pytest.approx(0.75 * 0.980665 * 180.0 / 3.141592653589793, rel=1e-9)
    assert found.fabric["weft"] == pytest.approx(490.3325 / 0.061, rel=1e-9)
    # LT = 0.8 is F = F_m (e / EMT)^1.5.
    assert found.fabric["warp"] == pytest.approx(4.903325 / (0.032 * 0.01 ** (1.0 / 1.5)), rel=1e-9)
    assert (
        found.fabric["hysteresis_warp"]
        == found.fabric["hysteresis_weft"]
        == pytest.approx(0.124 * 9.80665e-3, rel=1e-9)
    )
    assert found.how["hysteresis_weft"] == "measured: 2HB" and found.unused == ()


@pytest.mark.parametrize("suffix", [".csv", ".yaml"])
def test_names_in_capitals_or_not_are_the_same(suffix: str, tmp_path: Path) -> None:
    """No two names of an instrument differ by their capitals alone; one value written both ways is refused."""
    for columns in (SHEETS[name].keys() | UNUSED[name] for name in SHEETS):
        assert len({name.lower() for name in columns}) == len(columns)
    text = COMMAS if suffix == ".csv" else KES
    swapped = re.sub(r"(?m)^\w+", lambda name: name[0].swapcase(), text)
    assert read(tmp_path, swapped, suffix=suffix).fabric == read(tmp_path, text, suffix=suffix).fabric
    with pytest.raises(BadInput, match="given twice"):
        read(tmp_path, text + ("w;12,1\n" if suffix == ".csv" else "w: 12.1\n"), suffix=suffix)


@pytest.mark.parametrize(
    ("text", "doubted"),
    [
        (KES, False), (KES.replace("12.1", "121"), True), (KES.replace("12.1", "121 mg/cm^2"), False),
        (KES.replace("12.1", "60"), True), (FAST, False), (FAST.replace("200", "20"), True),
    ],
)  # fmt: skip
def test_a_weight_that_fits_the_other_unit_gets_a_remark(text: str, doubted: bool, tmp_path: Path) -> None:
    """121 mg/cm^2 is 2.5 times the weight of the heaviest twentieth of fabrics; 121 g/m^2 is a shirt's."""
    assert ("write its unit" in read(tmp_path, text).how["density"]) == doubted


@pytest.mark.parametrize("suffix", [".csv", ".yaml"])
@pytest.mark.parametrize(
    ("name", "given", "doubted"),
    [
        ("W", ("12.1",), ""), ("W", ("121",), "density"), ("W", ("121 mg/cm^2",), ""),
        ("B", ("0.118", "0.076"), ""), ("B", ("9.5", "0.076"), "bend_warp"), ("B", ("0.118", "9.5"), "bend_weft"),
        ("B", ("9.5 gf*cm^2/cm", "0.076 gf*cm^2/cm"), ""), ("B", ("9.5",), "bend_warp bend_weft"),
    ],
)  # fmt: skip
def test_a_table_and_a_yaml_file_get_the_same_remarks(
    suffix: str, name: str, given: tuple[str, ...], doubted: str, tmp_path: Path
) -> None:
    """A rigidity of 9.5 uN m, as FAST has it, is 98 times as much in the unit of KES-F, above all but few fabrics."""
    table = {"W": ("12.1",), "B": ("0.118", "0.076"), "G": ("0.7", "0.8"), "LT": ("0.8", "1.0"), "EMT": ("3.2", "6.1")}
    rows = (table | {name: given}).items()
    if suffix == ".csv":
        text = "instrument, KES-F\n" + "".join(f"{one}, {', '.join(parts)}\n" for one, parts in rows)
    else:
        text = "instrument: KES-F\n" + "".join(
            f"{one}: {parts[0] if one == 'W' or len(parts) == 1 else list(parts)}\n" for one, parts in rows
        )
    how = read(tmp_path, text, suffix=suffix).how
    assert [measure for measure, words in how.items() if "write its unit" in words] == doubted.split()


def test_a_heading_is_passed_over_and_what_is_not_available_is_missing(tmp_path: Path) -> None:
    instrument, *lines = POINTS.splitlines()
    rows = [[*line.split(", "), ""][:3] for line in lines]
    units = {"W": "mg/cm2", "B": "gf.cm2/cm", "G": "gf/(cm.degree)", "LT": "-", "EMT": "%"}
    tables = {
        "property,warp,weft": rows,
        "property,Unit,Warp,Weft": [[row[0], units[row[0]], *row[1:]] for row in rows],
        "property,warp,weft,units": [[*row, units[row[0]]] for row in rows],
        ",,warp,weft,unit": [["", *row, units[row[0]]] for row in rows],
    }
    expected = pytest.approx(read(tmp_path, POINTS, suffix=".csv").fabric, rel=1e-9)
    for heading, table in tables.items():
        text = "\n".join([instrument, heading, *map(",".join, table)])
        assert read(tmp_path, text, suffix=".csv").fabric == expected
    with pytest.raises(BadInput, match="the weft's number is missing"):
        import_text(tmp_path, POINTS.replace("0.076", "n/a"))
    with pytest.raises(BadInput, match="the weft's number is missing"):
        import_text(tmp_path, KES.replace("0.076", "n/a"), ".yaml")


def test_wt_says_what_lt_does(tmp_path: Path) -> None:
    work = [0.8 * 0.5 * 500.0 * 0.032, 1.0 * 0.5 * 500.0 * 0.061]
    given = KES.replace("LT: [0.8, 1.0]", f"WT: {work}")
    for name, value in read(tmp_path, given).fabric.items():
        assert value == pytest.approx(read(tmp_path, KES).fabric[name], rel=1e-9)


@pytest.mark.parametrize("instrument", ["FAST", "cantilever"])
def test_a_bending_length_in_centimetres_is_refused(instrument: str, tmp_path: Path) -> None:
    """1.8 mm bends a thousand times as easily as 1.8 cm: W g C^3."""
    text = f"instrument: {instrument}\nW: 150\nC: [18, 15]\n"
    found = read(tmp_path, text, "denim").fabric
    assert found == read(tmp_path, text.replace("[18, 15]", "[1.8 cm, 1.5 cm]"), "denim").fabric
    with pytest.raises(BadInput, match="no fabric is known to bend so") as caught:
        read(tmp_path, text.replace("[18, 15]", "[1.8, 1.5]"), "denim")
    assert caught.value.field == "C"


def test_strains_that_fall_with_the_load_are_refused(tmp_path: Path) -> None:
    assert read(tmp_path, f"{FAST}E20: [1.1, 2.4]\nE100: [2, 5]\n").unused == ("E20", "E100")
    with pytest.raises(BadInput, match="E5 is above E20"):
        read(tmp_path, f"{FAST}E20: [1.1, 1.1]\n")


def test_work_and_linearity_that_contradict_each_other_are_refused(tmp_path: Path) -> None:
    work = [0.8 * 0.5 * 500.0 * 0.032, 1.0 * 0.5 * 500.0 * 0.061]
    assert read(tmp_path, f"{KES}WT: {work}\n").fabric == read(tmp_path, KES).fabric
    with pytest.raises(BadInput, match="do not fit"):
        read(tmp_path, f"{KES}WT: {[work[0], 1.2 * work[1]]}\n")


def test_fast_values_are_read_in_their_units(tmp_path: Path) -> None:
    """B [uN m] = 9.807e-6 W [g/m^2] c^3 [mm^3], G = 123 / EB5: the FAST manual's formulas."""
    found = read(tmp_path, FAST).fabric
    assert found["bend_warp"] == pytest.approx(1e-6 * 9.80665e-6 * 200 * 20**3, rel=1e-9)
    assert found["bend_weft"] == pytest.approx(1e-6 * 9.80665e-6 * 200 * 16**3, rel=1e-9)
    assert found["shear"] == pytest.approx(123.0 / 4.1, rel=1e-12)
    assert found["warp"] == pytest.approx(4.903325 / 0.005, rel=1e-9)


@pytest.mark.parametrize(
    ("changed", "field", "computed"),
    [
        ("B: [11.2, 6.6]\n", "B", "15.7 uN*m, warp"), ("B: [15.0, 10.1]\n", "B", "8.03 uN*m, weft"),
        ("G: 60\n", "G", "30 N/m"), ("B: [15.7, 8.03]\nG: 24.1\n", "", ""),
        ("B: [15.7, 8.03]\nG: 23.9\n", "G", "30 N/m"),
    ],
)  # fmt: skip
def test_what_fast_computes_fits_what_it_is_computed_from(
    tmp_path: Path, changed: str, field: str, computed: str
) -> None:
    if field:
        with pytest.raises(BadInput) as caught:
            read(tmp_path, FAST + changed)
        assert caught.value.field == field and computed in caught.value.problem
        return
    found = read(tmp_path, FAST + changed)
    assert (found.fabric["bend_warp"], found.fabric["shear"]) == (pytest.approx(15.7e-6), pytest.approx(24.1))
    assert "C" in found.how["bend_warp"] and "EB5" in found.how["shear"]


@pytest.mark.parametrize("text", [KES, FAST], ids=["KES-F", "FAST"])
def test_virtual_tests_give_the_sheet_back(tmp_path: Path, text: str) -> None:
    """Within the bar of 2 %, but for rounding."""
    found = read(tmp_path, text)
    assert set(found.measured) == {"density", "warp", "weft", "shear", "bend_warp", "bend_weft"}
    for name, value in found.measured.items():
        assert found.fabric[name] == pytest.approx(value, rel=1e-3), name


def test_what_is_missing_is_asked_for_or_taken_from_a_preset(tmp_path: Path) -> None:
    text = "instrument: cantilever\nW: 150\nC: 18 mm\n"
    with pytest.raises(BadInput, match="does not tell warp, weft, shear") as caught:
        read(tmp_path, text)
    assert "--like" in str(caught.value.remedy)
    found = read(tmp_path, text, "denim")
    assert found.how["warp"] == "assumed: as of denim" and found.how["bend_warp"].startswith("derived")
    with pytest.raises(BadInput, match="unknown fabric preset") as caught:
        read(tmp_path, text, "denin")
    assert "did you mean 'denim'" in str(caught.value)


@pytest.mark.parametrize(
    ("old", "new", "field", "words"),
    [
        ("W: 12.1", "W: -12.1", "W", "cannot be negative"),
        ("W: 12.1", "W: 121000", "W", "618 measured fabrics"),
        ("W: 12.1", "W: 12 N/m", "W", "cannot be converted to kg/m"),
        ("W: 12.1", "W: [12, 13]", "W", "one number"),
        ("B: [0.118, 0.076]", "B: 118", "B", "gf*cm^2/cm"),
        ("2HB: 0.124", "2HB: 0.6", "2HB", "no room"),
        ("W: 12.1", "W: 12.1\nE5: 1.0", "E5", "is it instrument: FAST?"),
        ("W: 12.1", "W: 12.1\nBB: 1.0", "BB", "did you mean"),
        ("KES-F", "Instron", "instrument", "one of KES-F, FAST, cantilever"),
        ("LT: [0.8, 1.0]", "WT: 60", "WT", "LT below 2"),
        ("B: [0.118, 0.076]", "B: 0", "B", "no fabric is known to have that"),
    ],
)
def test_what_cannot_be_is_refused_by_name(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], old: str, new: str, field: str, words: str
) -> None:
    assert old in KES
    path = tmp_path / "sheet.yaml"
    path.write_text(KES.replace(old, new))
    assert main(["fabric", "import", str(path), "--out", str(tmp_path / "out.yaml")]) == 2
    said = capsys.readouterr().err
    assert f"{field}: " in said and words in said
    assert f"{path}:" in said
    assert not (tmp_path / "out.yaml").exists()


def test_the_command_writes_what_a_scene_takes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    sheet, out = tmp_path / "sheet.csv", tmp_path / "cotton.yaml"
    lines = ("# ours", "source, a laboratory, 2026", "instrument, KES-F", "W, 121, g/m^2", "B, 0.118, 0.076")
    sheet.write_text("\n".join((*lines, "G, 0.8, 0.7", "LT, 0.8, 1.0", "EMT, 3.2, 6.1")))
    assert main(["fabric", "import", str(sheet), "--out", str(out)]) == 0
    assert "measured: B" in capsys.readouterr().out
    fabric = yaml.safe_load(out.read_text())["fabric"]
    scene = {
        "nuno": 1, "name": "own", "duration": 0.1, "frame_rate": 10,
        "objects": [{"name": "cloth", "model": {"plugin": "sheet", "resolution": [4, 4], "fabric": fabric}}],
    }  # fmt: skip
    (tmp_path / "scene.yaml").write_text(yaml.safe_dump(scene))
    assert main(["plan", str(tmp_path / "scene.yaml")]) == 0
    assert read(tmp_path, KES).fabric["bend_weft"] == pytest.approx(float(fabric["bend_weft"].split()[0]), rel=1e-5)


def test_what_a_sheet_does_not_tell_is_said_to_be_derived_or_assumed(tmp_path: Path) -> None:
    how = read(tmp_path, "instrument: cantilever\nW: 150\nC: [18, 16]\nC45: 17\n", "denim").how
    assert how.keys() == registry.load("nuno.models", "sheet").presets()[0].how.keys()
    kinds = {name: words.split(":")[0] for name, words in how.items()}
    assert kinds["density"] == "measured" and kinds["bend_bias"] == kinds["bend_twist"] == "derived"
    assert kinds["warp"] == kinds["bend_poisson"] == kinds["hysteresis_warp"] == kinds["damping_ratio"] == "assumed"


def test_words_of_several_lines_stay_in_their_comment(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "sheet.yaml"
    path.write_text(KES + "name: |\n  cotton\n  fabric: 3\nsource: [a, b]\n")
    assert main(["fabric", "import", str(path), "--out", str(tmp_path / "out.yaml")]) == 0
    capsys.readouterr()
    text = (tmp_path / "out.yaml").read_text()
    assert text.startswith("# cotton fabric: 3: KES-F, sheet.yaml\n# source: ['a', 'b']\nfabric:\n")
    assert list(yaml.safe_load(text)) == ["fabric"]


def photograph(path: Path, shape: str, pixel: float = 0.25e-3) -> None:
    """Dark on light beside a dark label, with noise and off the middle: radius 12 cm and six folds of 1 cm."""
    rows, columns = np.arange(1300)[:, None] - 620, np.arange(1500)[None] - 810
    radius, turn = pixel * np.hypot(rows, columns), np.arctan2(rows, columns)
    dark = (radius < 0.12 + 0.01 * np.cos(6.0 * turn)) & (radius > 2e-3)
    dark[20:60, 20:300] = True
    dark |= shape == "dark"
    if shape == "cut":
        dark[620:630] = True
    grey = np.where(dark, 60.0, 190.0) + np.random.default_rng(1).normal(0.0, 8.0, dark.shape)
    Image.fromarray(np.clip(grey, 0.0, 255.0).astype(np.uint8)).save(path)


@pytest.mark.parametrize("suffix", ["png", "jpg"])
def test_a_photograph_tells_its_shadows_area_and_nodes(tmp_path: Path, suffix: str) -> None:
    """Of a radius r + a cos 6 t the area is pi (r^2 + a^2 / 2)."""
    photograph(tmp_path / f"shadow.{suffix}", "folds")
    found = read(tmp_path, KES + f"shadow: shadow.{suffix}\nmm per pixel: 0.25\n")
    share = (0.12**2 + 0.5 * 0.01**2 - 0.09**2) / (0.15**2 - 0.09**2)
    assert found.drape["drape_coefficient"] == pytest.approx(100.0 * share, abs=0.5)
    assert found.drape["nodes"] == 6.0 and found.how["nodes"] == f"measured: shadow.{suffix}"
    assert found.fabric == read(tmp_path, KES).fabric


POINTS = "instrument, KES-F\nW, 12.1\nB, 0.118, 0.076\nG, 0.8, 0.7\nLT, 0.8, 1.0\nEMT, 3.2, 6.1\n"
COMMAS = POINTS.replace(", ", ";").replace(".", ",")


@pytest.mark.parametrize(
    "text",
    [
        COMMAS,
        "\ufeff" + COMMAS.replace("\n", "\r\n"),
        COMMAS.replace(";", "\t"),
        COMMAS.replace("12,1", "12,1 mg/cm²").replace("3,2;6,1", '"3,2";"6,1";"%"'),
        "\n".join(",".join(f'"{cell}"' for cell in line.split(";")) for line in COMMAS.splitlines()),
    ],
)
def test_a_sheet_with_decimal_commas_is_read_as_its_twin_with_points(text: str, tmp_path: Path) -> None:
    found, twin = (read(tmp_path, one, suffix=".csv").fabric for one in (text, POINTS))
    assert found == pytest.approx(twin, rel=1e-12)


@pytest.mark.parametrize(
    ("old", "new", "missing"),
    [
        ("B;0,118;0,076", "B;0,118;", "weft"),
        ("B;0,118;0,076", "B;;0,076", "warp"),
        ("B;0,118;0,076", "B;0,118;;gf*cm^2/cm", "weft"),
        ("B;0,118;0,076", "B;;0,076;gf*cm^2/cm", "warp"),
        ("EMT;3,2;6,1", "EMT;;6,1;;", "warp"),
    ],
)
def test_an_empty_cell_is_a_missing_measurement(old: str, new: str, missing: str, tmp_path: Path) -> None:
    """It was taken for both directions, and called measured."""
    name, *cells = new.split(";")
    with pytest.raises(BadInput, match=f"the {missing}'s number is missing") as caught:
        import_text(tmp_path, COMMAS.replace(old, new))
    line = next(n for n, each in enumerate(COMMAS.splitlines(), 1) if each == old)
    assert (caught.value.field, caught.value.line) == (name, line)
    number = next(cell for cell in cells if cell)
    both = read(tmp_path, COMMAS.replace(old, f"{name};{number};{number}"), suffix=".csv").fabric
    assert both == read(tmp_path, COMMAS.replace(old, f"{name};{number}"), suffix=".csv").fabric


def test_empty_cells_of_columns_without_numbers_say_nothing(tmp_path: Path) -> None:
    """As a spreadsheet fills up its lines; the weight is of no direction."""
    single = "instrument;KES-F\nW;12,1\nB;0,118\nG;0,8\nLT;0,8\nEMT;3,2\n"
    for plain, filled in (
        (single, single.replace("\n", ";;\n") + ";;;\n"),
        (COMMAS, COMMAS.replace("12,1", "12,1;") + "DC;60;;\n"),
        (COMMAS, COMMAS.replace("12,1", "12,1;;mg/cm^2")),
    ):
        found, twin = (read(tmp_path, text, suffix=".csv").fabric for text in (filled, plain))
        assert found == pytest.approx(twin, rel=1e-12)


@pytest.mark.parametrize(
    ("text", "old", "new", "field"),
    [
        (KES, "[3.2, 6.1]", "[0.032, 0.061]", "EMT"),
        (COMMAS, "EMT;3,2;6,1", "EMT;0,032;0,061", "EMT"),
        (FAST, "EB5: 4.1", "EB5: 0.041", "EB5"),
        (FAST, "[0.5, 1.2]", "[0.005, 1.2]", "E5"),
    ],
)
def test_a_strain_that_may_be_a_fraction_is_asked_about(
    text: str, old: str, new: str, field: str, tmp_path: Path
) -> None:
    """A spreadsheet stores 3.2 % as 0.032: cloth was a hundred times too stiff. With its unit it is taken."""
    suffix = ".csv" if text is COMMAS else ".yaml"
    with pytest.raises(BadInput, match="a fraction") as caught:
        import_text(tmp_path, text.replace(old, new), suffix)
    assert caught.value.field == field and caught.value.line is not None
    if text is KES:
        assert str(caught.value.remedy) == "write 3.2, or '0.032 percent'"
        read(tmp_path, text.replace(old, "['0.032 percent', 0.061 %]"))


@pytest.mark.parametrize(
    ("text", "field", "value"),
    [
        (POINTS.replace("0.8, 0.7", "1,2"), "G", "1,2"),
        (POINTS.replace("0.8, 0.7", "1,2, gf/cm/degree"), "G", "1,2"),
        (POINTS.replace("12.1", "12,1"), "W", "12,1"),
        (POINTS.replace("0.118, 0.076", "0,118, 0,076"), "B", "0,118"),
        (POINTS + "drape coefficient, 63,5\n", "drape coefficient", "63,5"),
        (POINTS.replace("0.8, 0.7", '"1,2"'), "G", "1,2"),
        (COMMAS.replace("0,8;0,7", "0.8;0.7"), "W", "12,1"),
        (COMMAS.replace("12,1", "1.210,5"), "B", "0,118"),
        ("instrument;KES-F\nW;12,100\nG;1,200;1,100\n", "W", "12,100"),
    ],
)
def test_a_comma_that_may_part_something_else_is_refused(text: str, field: str, value: str, tmp_path: Path) -> None:
    with pytest.raises(BadInput, match="comma") as caught:
        read(tmp_path, text, suffix=".csv")
    error = caught.value
    line = next(n for n, each in enumerate(text.splitlines(), 1) if each.startswith(field))
    assert (error.field, error.value, error.line) == (field, value, line)
    assert error.remedy is not None and f"write {value.replace(',', '.')}" in error.remedy


@pytest.mark.parametrize("written", ["1.25", "5/4", "1.25 ", "125e-2"])
def test_a_quoted_number_is_in_the_instruments_unit(written: str, tmp_path: Path) -> None:
    """As text it was taken in SI: 1.25 N/m of shear for 70."""
    found = read(tmp_path, KES.replace("[0.8, 0.7]", f"'{written}'").replace("W: 12.1", "W: '12.1'"))
    assert found.fabric == pytest.approx(read(tmp_path, KES.replace("[0.8, 0.7]", "1.25")).fabric, rel=1e-12)
    with pytest.raises(BadInput, match="a decimal comma") as caught:
        read(tmp_path, KES.replace("[0.8, 0.7]", "'1,25'"))
    assert caught.value.remedy == "write 1.25"


@pytest.mark.parametrize(
    ("lines", "field", "words"),
    [
        ("DC: 120", "DC", "1 to 100 percent"),
        ("Drape Coefficient: -3 %", "Drape Coefficient", "cannot be negative"),
        ("DC: 60\ndrape_coefficient: 61", "drape_coefficient", "given twice"),
        ("nodes: 6.5", "nodes", "whole number"),
        ("nodes: -1", "nodes", "cannot be negative"),
        ("drape coeficient: 60", "drape coeficient", "did you mean 'drape coefficient'"),
        ("DC: 60\nsupport: 30", "support", "below 30 cm"),
        ("shadow: folds.png", "shadow", "add mm per pixel"),
        ("mm per pixel: 0.25", "mm per pixel", "add shadow"),
        ("mm per pixel: 0\nshadow: folds.png", "mm per pixel", "0.01 to 5 mm"),
        ("mm per pixel: 0.25\nshadow: folds.png\nDC: 60", "DC", "the photograph tells this too"),
        ("mm per pixel: 0.25\nshadow: none.png", "shadow", "No such file"),
        ("mm per pixel: 0.25\nshadow: sheet.yaml", "shadow", "cannot be read"),
        ("mm per pixel: 0.25\nshadow: dark.png", "shadow", "as dark, or as light, everywhere"),
        ("mm per pixel: 0.25\nshadow: cut.png", "shadow", "reaches the picture's edge"),
        ("mm per pixel: 0.15\nshadow: folds.png", "shadow", "smaller than the support"),
        ("mm per pixel: 0.35\nshadow: folds.png", "shadow", "larger than the specimen"),
    ],
)
def test_a_drape_that_cannot_be_is_refused_by_name(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], lines: str, field: str, words: str
) -> None:
    for shape in ("folds", "dark", "cut"):
        if shape in lines:
            photograph(tmp_path / f"{shape}.png", shape)
    path = tmp_path / "sheet.yaml"
    path.write_text(KES + lines)
    assert main(["fabric", "import", str(path)]) == 2
    said = capsys.readouterr().err
    assert f": {field}: " in said and words in said and f"{path}:" in said


def test_a_measured_drape_is_held_against_the_virtual_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path, out = tmp_path / "sheet.yaml", tmp_path / "cotton.yaml"
    path.write_text(KES + "drape coefficient: 63 %\nnumber of nodes: 7\nspecimen: 24 cm\n")
    assert main(["fabric", "import", str(path), "--out", str(out)]) == 0
    name, fabric, measured = find_fabric(str(out))
    assert name == "cotton" and isinstance(fabric, dict) and "drape_coefficient" not in fabric
    hung: list[Any] = []

    def hang(*given: Any) -> specimens.Drape:
        hung.append(given[4:])
        return specimens.Drape(0.65, 6, -1e-3, np.zeros((2, 2), np.bool_), np.zeros((1, 3)))

    monkeypatch.setattr(specimens, "drape", hang)
    quick, whole = (sheet.TestOptions(each, Executor(), lambda text: None) for each in (True, False))
    rows = sheet.test(fabric, ["drape"], quick, measured).rows
    assert set(hung) == {(0.12, 0.09)}
    assert [row.measured for row in rows] == [True, True, False]
    coefficient, nodes, _ = (cells(row) for row in rows)
    assert coefficient[1:6] == ["ISO 9073-9, 24 cm on 18 cm", "65", "%", "63, measured", "+2.0 points"]
    assert nodes[2:6] == ["6", "", "7, measured", "-14.29 %"]
    for row in sheet.test(fabric, ["drape"], whole, measured).rows:
        given = row.what.startswith("nodes, started in")
        assert row.measured == (row.what.startswith(("drape coefficient", "nodes")) and not given)
    rows = sheet.test(fabric, ["drape"], quick, {}).rows
    assert cells(rows[0])[1:6] == ["ISO 9073-9, 30 cm on 18 cm", "65", "%", "", ""]


def test_what_a_file_says_was_measured_is_checked(tmp_path: Path) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text("fabric: denim\nmeasured:\n  drape_coefficient: 130 %\n")
    with pytest.raises(BadInput, match="no fabric is known") as caught:
        find_fabric(str(path))
    assert f"{path}:3: measured.drape_coefficient" in str(caught.value)
    path.write_text("fabric: denim\nmeasured: {foldes: 3}\n")
    with pytest.raises(BadInput, match="not a value of a drape"):
        find_fabric(str(path))
    path.write_text("fabric: denim\nmeasured: 65 %\n")
    with pytest.raises(BadInput, match="values by name"):
        find_fabric(str(path))


NAMES = ("silk", "canvas")


@pytest.fixture(scope="module")
def text(tmp_path_factory: pytest.TempPathFactory) -> str:
    path = tmp_path_factory.mktemp("page") / "fabrics.html"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(swatches, "LOOK", swatches.LOOK | {"duration": "3 s", "objects.0.model.edge": "1.5 cm"})
        assert main(["fabrics", *NAMES, "--page", str(path)]) == 0
    return unescape(path.read_text())


@pytest.mark.full
def test_each_fabric_is_shown_draped_and_a_limp_one_falls_in_more_folds(text: str) -> None:
    pictures = [
        np.asarray(Image.open(io.BytesIO(base64.b64decode(data))).convert("RGB"), float)
        for data in re.findall(r"data:image/png;base64,([\w+/=]+)", text)
    ]
    assert [one.shape for one in pictures] == [(320, 480, 3)] * 2
    # Cadet blue is more blue than red by far, and the ground is the other way round.
    covered = [(one[..., 2] - one[..., 0] > 30.0).mean() for one in pictures]
    assert all(0.15 < share < 0.6 for share in covered)
    assert np.abs(pictures[0] - pictures[1]).mean() > 5.0
    drapes = {name: (int(share), int(folds)) for name, share, folds in re.findall(r"(\w+): (\d+) %, (\d+) folds", text)}
    assert drapes.keys() == set(NAMES)
    assert drapes["silk"][0] < drapes["canvas"][0] and drapes["silk"][1] > drapes["canvas"][1]


@pytest.mark.full
def test_its_measures_and_sources_are_those_that_are_printed(text: str) -> None:
    presets = find_presets("fabrics")
    for name in NAMES:
        preset = presets[name]
        assert preset.source in text
        for measure in preset.measures:
            assert f"{measure.name} [{measure.unit or '1'}]" in text
            assert f">{digits(measure.given)}<" in text
        for words in preset.how.values():
            assert words.partition(": ")[2] in text
    assert "denim:" not in text


@pytest.mark.full
def test_nothing_is_fetched(text: str) -> None:
    assert set(re.findall(r"(?:src|href)=\"?(\w+)", text)) == {"data"}


@pytest.mark.full
def test_without_a_page_the_list_is_printed(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["fabrics", "silk"]) == 0
    assert "69.44" in capsys.readouterr().out
    assert main(["fabrics", "slik", "--page", "never.html"]) == 2
    assert "did you mean 'silk'?" in capsys.readouterr().err and not Path("never.html").exists()
