"""The viewer's compiled loops need no cache."""

from __future__ import annotations

from pathlib import Path

import numba
import pytest

from nuno.viewer.kernels import compiled


def twice(x: float) -> float:
    return 2.0 * x


@pytest.mark.parametrize("kind", ["nbi", "nbc"])
def test_a_damaged_file_of_the_cache_is_done_without(
    kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path))
    assert compiled("float64(float64)")(twice)(1.5) == 3.0
    (file,) = tmp_path.glob(f"**/*.{kind}")
    file.write_bytes(file.read_bytes()[:40])
    assert compiled("float64(float64)")(twice)(1.5) == 3.0
