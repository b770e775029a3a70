"""From a scene file to validated plugins: every error names file, line, field and remedy."""

from __future__ import annotations

import inspect
import typing
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from importlib.resources import files as package_files
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ValidationError

from nuno import registry, yaml_lines
from nuno.files import SceneFiles
from nuno.yaml_lines import dotted
from nuno_schemas.errors import BadInput, nearest
from nuno_schemas.scene import Choice, Scene


@dataclass
class Chosen:
    """A plugin picked by a scene: the instance, its validated configuration, where it stands."""

    group: str
    plugin: Any
    config: BaseModel
    field: str

    @property
    def name(self) -> str:
        return str(self.plugin.name)


@dataclass
class Loaded:
    """A scene with its plugins found and their configurations validated."""

    scene: Scene
    data: dict[str, Any]
    """The scene as read, with overrides applied: what a recording keeps."""
    file: str
    lines: dict[yaml_lines.Path, int]
    files: SceneFiles
    models: list[Chosen]
    integrator: Chosen
    colliders: list[Chosen]
    motions: list[Chosen | None]
    forces: list[Chosen]
    contact: Chosen | None
    overrides: tuple[str, ...] = ()

    def at(self, field: str, error: BadInput) -> BadInput:
        """The same error with this scene's file, line and the field's full path."""
        return located(error, self.file, self.lines, field)


def shipped() -> dict[str, Path]:
    """The scenes that come with the project, by name."""
    beside = Path(__file__).resolve().parents[2] / "scenes"
    folder = beside if beside.is_dir() else Path(str(package_files("nuno"))) / "scenes"
    return {path.stem: path for path in sorted(folder.glob("*.yaml"))}


def find(name: str) -> Path:
    """A scene file by path, or a shipped one by name. Raises BadInput."""
    path = Path(name)
    if path.is_file():
        return path
    scenes = shipped()
    if path.suffix == "" and name in scenes:
        return scenes[name]
    raise BadInput("no such scene", value=name, remedy=f"{nearest(path.stem, scenes)}; or give the path of a YAML file")


def read(path: Path, overrides: Sequence[str] = (), roots: Iterable[Path] = ()) -> Loaded:
    """Read, override and validate a scene file. Raises BadInput."""
    try:
        text = path.read_text(encoding="utf-8")
    except UnicodeDecodeError:
        raise BadInput("not a text file", str(path), remedy="a scene is YAML in UTF-8") from None
    except OSError as error:
        raise BadInput(f"cannot be read: {error.strerror}", str(path)) from None
    data, lines = yaml_lines.parse(text, str(path))
    for item in overrides:
        apply_override(data, item)
    return replace(
        load(data, lines, str(path), SceneFiles(path.resolve().parent, tuple(roots))), overrides=tuple(overrides)
    )


def apply_override(data: dict[str, Any], item: str) -> None:
    """Set `a.b.0.c=value` in place. Raises BadInput for a path that cannot be there."""
    key, equals, text = item.partition("=")
    if not equals or not key:
        raise BadInput(
            "an override is written key=value", "--set", value=item, remedy="for example --set solver.dt=1ms"
        )
    *parents, last = key.replace("[", ".").replace("]", "").split(".")
    place: Any = data
    for part in parents:
        if isinstance(place, list) and part.isdigit() and int(part) < len(place):
            place = place[int(part)]
        elif isinstance(place, dict):
            place = place.setdefault(part, {})
        else:
            raise BadInput(
                "no such field", "--set", field=key, value=part, remedy="name an existing list item or field"
            )
    if isinstance(place, list) and last.isdigit() and int(last) < len(place):
        place[int(last)] = yaml_lines.parse_value(text)
    elif isinstance(place, dict):
        place[last] = yaml_lines.parse_value(text)
    else:
        raise BadInput("no such field", "--set", field=key, value=last, remedy="name an existing list item or field")


def load(data: dict[str, Any], lines: dict[yaml_lines.Path, int], file: str, files: SceneFiles) -> Loaded:
    """Validate a scene's data and find its plugins. Raises BadInput."""
    try:
        scene = Scene.model_validate(data)
    except ValidationError as error:
        raise _explain(error, Scene, (), file, lines) from None

    def chosen(group: str, choice: Choice, field: yaml_lines.Path) -> Chosen:
        try:
            plugin = registry.load(group, choice.plugin)
            return Chosen(group, plugin, plugin.Config.model_validate(choice.config), dotted(field))
        except ValidationError as error:
            raise _explain(error, plugin.Config, field, file, lines) from None
        except BadInput as error:
            raise located(error, file, lines, dotted((*field, "plugin"))) from None

    return Loaded(
        scene,
        data,
        file,
        lines,
        files,
        models=[chosen("nuno.models", o.model, ("objects", i, "model")) for i, o in enumerate(scene.objects)],
        integrator=chosen("nuno.integrators", scene.solver, ("solver",)),
        colliders=[chosen("nuno.colliders", b.collider, ("bodies", i, "collider")) for i, b in enumerate(scene.bodies)],
        motions=[
            chosen("nuno.motions", b.motion, ("bodies", i, "motion")) if b.motion else None
            for i, b in enumerate(scene.bodies)
        ],
        forces=[chosen("nuno.forces", f, ("forces", i)) for i, f in enumerate(scene.forces)],
        contact=chosen("nuno.contacts", scene.contact, ("contact",)) if scene.bodies else None,
    )


def located(error: BadInput, file: str, lines: dict[yaml_lines.Path, int], field: str) -> BadInput:
    """Fill in where an error stands, keeping what it already says."""
    if error.file is not None and error.field is not None:
        return error
    full = f"{field}.{error.field}" if error.field else field
    line = next(
        (n for path, n in sorted(lines.items(), key=lambda item: -len(item[0])) if _under(full, dotted(path))), None
    )
    return BadInput(error.problem, error.file or file, error.line or line, full, error.value, error.limit, error.remedy)


def _under(field: str, path: str) -> bool:
    return field == path or (path != "" and field.startswith(path) and field[len(path)] in ".[")


def _explain(
    error: ValidationError,
    model: type[BaseModel],
    prefix: yaml_lines.Path,
    file: str,
    lines: dict[yaml_lines.Path, int],
) -> BadInput:
    """The first of pydantic's errors in the user's words."""
    first = min(error.errors(), key=lambda e: (e["type"] == "missing", len(e["loc"])))
    loc: yaml_lines.Path = tuple(part for part in first["loc"] if isinstance(part, int) or not _is_branch(part))
    path = (*prefix, *loc)
    problem, value, remedy = first["msg"].removeprefix("Value error, "), first.get("input"), None
    if first["type"] == "extra_forbidden":
        problem, value = "no such field", loc[-1]
        remedy = nearest(str(loc[-1]), _fields_at(model, loc[:-1]))
    elif first["type"] == "missing":
        problem, value, remedy = "the field is missing", None, "add it"
    return located(BadInput(problem, value=value, remedy=remedy), file, lines, dotted(path))


def _is_branch(part: str) -> bool:
    """pydantic names the branch of a union in its location; those are no fields."""
    return (
        part.startswith(
            ("function-", "constrained-", "literal[", "float", "int", "str", "bool", "tuple", "list", "dict")
        )
        and not part.isidentifier()
    ) or part in {"float", "int", "str", "bool"}


def _fields_at(model: Any, loc: yaml_lines.Path) -> list[str]:
    """Field names of the model that a location in `model` points at."""
    for part in loc:
        if isinstance(part, int):
            continue
        fields = getattr(model, "model_fields", {})
        if part not in fields:
            return []
        model = next(iter(_models_in(fields[part].annotation)), None)
    names = list(getattr(model, "model_fields", {}))
    return names


def _models_in(annotation: Any) -> list[type[BaseModel]]:
    if inspect.isclass(annotation) and typing.get_origin(annotation) is None and issubclass(annotation, BaseModel):
        return [annotation]
    return [m for arg in typing.get_args(annotation) for m in _models_in(arg)]
