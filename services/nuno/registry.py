"""Plugins by entry point: listed without importing any, imported only when a scene names one."""

from __future__ import annotations

from collections.abc import Iterable
from importlib.metadata import EntryPoint, entry_points
from typing import Any

from nuno_schemas.errors import BadInput, nearest
from nuno_schemas.plugin import GROUPS


def installed(group: str) -> dict[str, EntryPoint]:
    """Entry points of a group by name. Raises BadInput where two packages claim one name."""
    found: dict[str, EntryPoint] = {}
    for point in entry_points(group=group):
        other = found.get(point.name)
        if other is not None and other.value != point.value:
            owners = sorted(_package(p) for p in (other, point))
            raise BadInput(
                f"two installed packages offer the plugin {point.name!r} in {group}",
                value=owners,
                remedy=f"uninstall one of them: pip uninstall {owners[-1]}",
            )
        found[point.name] = point
    return found


def load(group: str, name: str, beside: Iterable[str] = ()) -> Any:
    """An instance of the plugin `name`. Raises BadInput if it is unknown or cannot be imported.

    `beside` are words that may stand for a plugin, such as "auto": an unknown name is answered with them, too.
    """
    points = installed(group)
    if name not in points:
        raise BadInput(
            f"no plugin {name!r} in {group} ({GROUPS[group]})", value=name, remedy=nearest(name, [*points, *beside])
        )
    try:
        return points[name].load()()
    except Exception as error:
        raise BadInput(
            f"the plugin {name!r} of {_package(points[name])} cannot be imported: {error}",
            value=points[name].value,
            remedy="reinstall or remove that package; `nuno plugins` lists what is installed",
        ) from error


def package_version(group: str, name: str) -> str:
    """`package version` that provides a plugin."""
    return _package(installed(group)[name])


def _package(point: EntryPoint) -> str:
    return f"{point.dist.name} {point.dist.version}" if point.dist else "unknown package"
