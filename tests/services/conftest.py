"""What tests of services share."""

from __future__ import annotations

from pathlib import Path

import pytest
from refusals import Refused


@pytest.fixture
def refused(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> Refused:
    return Refused(capfd, tmp_path)
