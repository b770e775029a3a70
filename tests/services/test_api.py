"""`import nuno` in a script or a notebook."""

from __future__ import annotations

import nuno


def test_the_module_lists_what_it_offers() -> None:
    assert {"run", "open", "Result"} <= set(dir(nuno))
    assert all(callable(getattr(nuno, name)) for name in nuno.__all__)
