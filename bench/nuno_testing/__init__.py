"""The contract of every kind of plugin as tests for pytest, for nuno's own plugins and those of other packages.

    from nuno_testing import contract

    test_forces = contract("nuno.forces", magnet={"stiffness": 0.02})

This package has the checks of each kind; laws of a single plugin belong to its own tests. pytest loads this module at
its start: nothing of nuno is imported before a test needs it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import pytest


@pytest.fixture
def nuno_folder(request: pytest.FixtureRequest) -> Path:
    """Folder of the files that a contract's configurations name: the test's own, unless a test module overrides it."""
    return request.path.parent


def contract(group: str, **plugins: Mapping[str, Any]) -> Callable[..., None]:
    """Return a test of the whole contract of a kind of plugin, with a case for each plugin and check.

    `group` is the kind's entry-point group, such as "nuno.forces"; `plugins` are names of installed plugins, each with
    the fields of a configuration to test, as in a scene.
    """
    from nuno_testing.checks import checks_of
    from nuno_testing.subject import make_subject

    pairs = [(name, check) for name in plugins for check in checks_of(group)]

    def keeps_the_contract(name: str, check: Callable[..., None], nuno_folder: Path) -> None:
        check(make_subject(group, name, plugins[name], nuno_folder))

    ids = [f"{name}-{check.__name__}" for name, check in pairs]
    test: Callable[..., None] = pytest.mark.parametrize(("name", "check"), pairs, ids=ids)(keeps_the_contract)
    return test
