"""Registry of plugins by entry point: listing imports none, and a plugin is imported when a scene names it. Scripts and
notebooks register classes, which are known to their process alone.
"""

from __future__ import annotations

import sys
import traceback
from collections.abc import Callable, Iterable
from functools import cache, partial
from importlib.metadata import Distribution, EntryPoint, entry_points
from typing import Any

from nuno.plugin_contract import containment
from nuno_schemas.errors import BadInput, nearest
from nuno_schemas.plugin import GROUPS

OWN = "nuno"
"""Distribution of the project's own plugins."""


class Registered(EntryPoint):
    """An entry point of this process alone: the class `kind`, in place of an installed package's."""

    kind: type

    def __init__(self, group: str, kind: Any) -> None:
        super().__init__(kind.name, f"{kind.__module__}:{kind.__qualname__}", group)
        vars(self).update(kind=kind)

    def load(self) -> Any:
        return self.kind


REGISTERED: dict[tuple[str, str], Registered] = {}
"""By group and name."""


def register(group: str, plugin: type) -> None:
    """Make a plugin known in this process, without a package: nuno.register("nuno.forces", Magnet), a class with a
    `name`, its `Config` and the methods of its kind. Scenes then name it like an installed one.

    The class may be registered again, as by a notebook's cell that runs twice: the last one counts. Other processes
    do not know it: `processes=True`, a sweep's `jobs` and the command need a package with an entry point.

    Raises BadInput for an unknown kind, for what is no plugin, and for a name that another plugin of the kind has.
    """
    if group not in GROUPS:
        raise BadInput("no such kind of plugin", field="group", value=group, remedy=nearest(str(group), GROUPS))
    name = getattr(plugin, "name", None)
    if not (isinstance(plugin, type) and isinstance(name, str) and name):
        remedy = f'nuno.register("{group}", Magnet): a class whose `name` is what scenes call it'
        raise BadInput("a plugin is a class with a name", field="plugin", value=repr(plugin), remedy=remedy)
    point = Registered(group, plugin)
    for other in claims(group).get(name, []):
        if not isinstance(other, Registered) or other.value != point.value:
            raise BadInput(
                f"there is a plugin {name!r} in {group} already: {other.value} of {package(other)}", field="plugin",
                value=point.value, remedy="give the class another `name`",
            )  # fmt: skip
    REGISTERED[group, name] = point


def require_installed(chosen: Iterable[Any], what: str, remedy: str) -> None:
    """Raise BadInput if one of a scene's chosen plugins is known to this process alone, and so not to `what`."""
    for one in chosen:
        if (point := REGISTERED.get((one.group, one.name))) is not None:
            raise BadInput(
                f"the plugin {one.name!r} in {one.group} is registered in this process, and {what} would not know it",
                value=point.value, remedy=f"{remedy}, or install it as a package with an entry point",
            )  # fmt: skip


def installed(group: str) -> dict[str, EntryPoint]:
    """Return the entry points of a group by name; the first of `claims` if several have one name."""
    return {name: points[0] for name, points in claims(group).items()}


def claims(group: str) -> dict[str, list[EntryPoint]]:
    """Return the entry points for each name of a group, the project's own first; more than one is an error."""
    found = {name: list(points) for name, points in _claims(entry_points, group, tuple(sys.path)).items()}
    for (kind, name), point in REGISTERED.items():
        if kind == group:
            found.setdefault(name, []).append(point)
    return found


@cache
def _claims(
    find: Callable[..., Iterable[EntryPoint]], group: str, path: tuple[str, ...]
) -> dict[str, list[EntryPoint]]:
    """Cache the entry points of a group, while the search path is the same.

    `find` reads the metadata of every installed package, in 10 ms, and a run calls it a dozen times.
    """
    points_by_name: dict[str, list[EntryPoint]] = {}
    for point in find(group=group):
        points = points_by_name.setdefault(point.name, [])
        if all(point.value != other.value for other in points):
            points.append(point)
    for points in points_by_name.values():
        points.sort(key=lambda point: (not is_own(point), package(point)))
    return points_by_name


def load(group: str, name: str, other_names: Iterable[str] = ()) -> Any:
    """Return an instance of the plugin `name`. Raises BadInput if it is unknown, ambiguous or cannot be imported.

    A plugin of another distribution is guarded (`nuno.plugin_contract.guards`). `other_names` are allowed in place of
    a plugin, such as "auto": the error for an unknown name lists them, too.
    """
    points_by_name = claims(group)
    if name not in points_by_name:
        raise _unknown(group, name, [*points_by_name, *other_names])
    point, *others = points_by_name[name]
    if others:
        owners = [package(each) for each in (point, *others)]
        foreign = next(each for each in reversed((point, *others)) if not is_own(each) or each is point)
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
    """Return the first installed plugin of a group with a method outside the group's protocol. Raises BadInput, which
    names the method's purpose as `what`, without one.
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
    """Return the `package version` that provides a plugin."""
    return package(installed(group)[name])


def package(point: EntryPoint) -> str:
    """Return the `package version` of an entry point, the module of a class that is registered."""
    return " ".join(_identity(point.dist)) if point.dist else point.value.partition(":")[0]


def distribution(point: EntryPoint) -> str:
    """Return the name of an entry point's package, "" for a class that is registered."""
    return _identity(point.dist)[0] if point.dist else ""


@cache
def _identity(dist: Distribution) -> tuple[str, str]:
    """Cache the name and version of an installed package: each is read anew from a file."""
    return dist.name, dist.version


def is_own(point: EntryPoint) -> bool:
    """Return whether a plugin is the project's own."""
    return distribution(point) == OWN


def _unknown(group: str, name: str, names: list[str]) -> BadInput:
    """Return the error for an unknown plugin, with groups that have one of that name."""
    packages = sorted({package(point) for points in claims(group).values() for point in points})
    elsewhere = [f"{other} has one ({GROUPS[other]})" for other in GROUPS if other != group and name in claims(other)]
    return BadInput(
        f"no plugin {name!r} in {group} ({GROUPS[group]})",
        value=name,
        limit="; ".join([f"looked in {group} of {', '.join(packages) or 'no package'}", *elsewhere]),
        remedy=nearest(name, names),
    )
