"""Plugins by entry point: listed without importing any, imported only when a scene names one."""

from __future__ import annotations

import sys
import traceback
from collections.abc import Callable, Iterable
from functools import cache, partial
from importlib.metadata import EntryPoint, entry_points
from typing import Any

from nuno.plugin_contract import containment
from nuno_schemas.errors import BadInput, nearest
from nuno_schemas.plugin import GROUPS

OWN = "nuno"
"""The distribution whose plugins are the project's own."""


def installed(group: str) -> dict[str, EntryPoint]:
    """Entry points of a group by name; of several of one name the one that `claims` gives first."""
    return {name: points[0] for name, points in claims(group).items()}


def claims(group: str) -> dict[str, list[EntryPoint]]:
    """For each name of a group the entry points that claim it, the project's own first: more than one is too many."""
    return {name: list(points) for name, points in _claims(entry_points, group, tuple(sys.path)).items()}


@cache
def _claims(
    find: Callable[..., Iterable[EntryPoint]], group: str, path: tuple[str, ...]
) -> dict[str, list[EntryPoint]]:
    """What `find` knows of a group, for as long as `path`, where it looks, is the same.

    It reads what every installed package says of itself, 10 ms each time, and a run asks a dozen times.
    """
    found: dict[str, list[EntryPoint]] = {}
    for point in find(group=group):
        points = found.setdefault(point.name, [])
        if all(point.value != other.value for other in points):
            points.append(point)
    for points in found.values():
        points.sort(key=lambda point: (not is_own(point), package(point)))
    return found


def load(group: str, name: str, beside: Iterable[str] = ()) -> Any:
    """An instance of the plugin `name`. Raises BadInput if it is unknown, claimed twice or cannot be imported.

    A plugin of another distribution is guarded (`nuno.plugin_contract.guards`). `beside` are words that may stand for
    a plugin, such as "auto": the error for an unknown name lists them, too.
    """
    found = claims(group)
    if name not in found:
        raise _unknown(group, name, [*found, *beside])
    point, *others = found[name]
    if others:
        owners = [package(one) for one in (point, *others)]
        foreign = next(one for one in reversed((point, *others)) if not is_own(one) or one is point)
        raise BadInput(
            f"two installed packages offer the plugin {name!r} in {group}",
            value=owners,
            remedy=f"uninstall one of them: pip uninstall {distribution(foreign)}",
        )
    kind = containment.call(partial(_not_imported, name, point), point.load)
    if lacking := sorted(getattr(kind, "__abstractmethods__", ())):
        raise BadInput(
            f"the plugin {name!r} of {package(point)} in {group} has no {', no '.join(lacking)}", value=point.value,
            remedy=containment.UNWRITTEN,
        )  # fmt: skip
    plugin = containment.call(partial(_not_imported, name, point), kind)
    if is_own(point):
        return plugin
    from nuno.plugin_contract.guards import Foreign

    return Foreign(plugin, group, name, package(point))


def offering(group: str, method: str, what: str) -> Any:
    """The first installed plugin of a group that has a method besides the group's protocol. Raises BadInput where none
    has, which says that none does `what`.
    """
    for name in sorted(installed(group)):
        plugin = load(group, name)
        if hasattr(plugin, method):
            return plugin
    raise BadInput(f"no installed plugin of {group} {what}", remedy="install nuno anew")


def _not_imported(name: str, point: EntryPoint, error: BaseException) -> BadInput:
    places = [f for f in traceback.extract_tb(error.__traceback__) if f.filename not in containment.OWN_FRAMES]
    where = [f"{places[-1].filename}:{places[-1].lineno}"] if places else []
    return BadInput(
        f"the plugin {name!r} of {package(point)} cannot be imported: {type(error).__name__}: {error}",
        value=", ".join([point.value, *where]),
        remedy="mend it, if the package is yours; if not, reinstall or remove it (`nuno plugins` lists all)",
    )


def package_version(group: str, name: str) -> str:
    """`package version` that provides a plugin."""
    return package(installed(group)[name])


def package(point: EntryPoint) -> str:
    """`package version` that an entry point comes from."""
    return f"{point.dist.name} {point.dist.version}" if point.dist else "unknown package"


def distribution(point: EntryPoint) -> str:
    """Name of the package that an entry point comes from."""
    return point.dist.name if point.dist else "unknown package"


def is_own(point: EntryPoint) -> bool:
    """Whether a plugin came with the project."""
    return distribution(point) == OWN


def _unknown(group: str, name: str, known: list[str]) -> BadInput:
    """What was looked for and where; and where a plugin of that name is, if it is of another kind."""
    packages = sorted({package(point) for points in claims(group).values() for point in points})
    elsewhere = [f"{other} has one ({GROUPS[other]})" for other in GROUPS if other != group and name in claims(other)]
    return BadInput(
        f"no plugin {name!r} in {group} ({GROUPS[group]})",
        value=name,
        limit="; ".join([f"looked in {group} of {', '.join(packages) or 'no package'}", *elsewhere]),
        remedy=nearest(name, known),
    )
