"""`nuno fabrics --page`: a picture, all measures and all sources of each fabric, with nothing from elsewhere."""

from __future__ import annotations

import base64
import io
import re
from html import unescape
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from nuno.cli import main
from nuno.cli.presets import digits, find_presets
from nuno_bench.instruments import swatches

pytestmark = pytest.mark.full
NAMES = ("silk", "canvas")


@pytest.fixture(scope="module")
def text(tmp_path_factory: pytest.TempPathFactory) -> str:
    path = tmp_path_factory.mktemp("page") / "fabrics.html"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(swatches, "LOOK", swatches.LOOK | {"duration": "3 s", "objects.0.model.edge": "1.5 cm"})
        assert main(["fabrics", *NAMES, "--page", str(path)]) == 0
    return unescape(path.read_text())


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


def test_nothing_is_fetched(text: str) -> None:
    assert set(re.findall(r"(?:src|href)=\"?(\w+)", text)) == {"data"}


def test_without_a_page_the_list_is_printed(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["fabrics", "silk"]) == 0
    assert "69.44" in capsys.readouterr().out
    assert main(["fabrics", "slik", "--page", "never.html"]) == 2
    assert "did you mean 'silk'?" in capsys.readouterr().err and not Path("never.html").exists()
