"""Loading of a scene file with validated plugins; every error names file, line, field and remedy."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from itertools import takewhile
from pathlib import Path
from typing import Any

from pydantic import BaseModel

from nuno.plugin_contract import registry
from nuno.process import check_compiler
from nuno.scene import shipped, yaml_lines
from nuno.scene.chosen_plugins import Chosen, choose_operation, choose_plugin
from nuno.scene.files import MARK, SceneFiles, read_scene
from nuno.scene.json_schema import PLACES
from nuno.scene.override import apply_override, item_at, number_or_name, overridden, parts_of
from nuno.scene.validation_errors import NO_FIELD, UNNUMBERED, located, models_in, validated
from nuno.scene.yaml_lines import dotted
from nuno_schemas.dyeing import Dyeing
from nuno_schemas.errors import BadInput, nearest
from nuno_schemas.fabric import Float
from nuno_schemas.operation import arranges
from nuno_schemas.parts import AUTO, Choice, Solver
from nuno_schemas.scene import ClothContact, Scene
from nuno_schemas.written import Path as FieldPath

FIRST, FIRST_DYE = "symplectic_euler", "explicit"
"""Solvers with the cheapest step, from which `auto` starts."""


@dataclass
class ChosenDye:
    """A scene's dyeing and its plugins; isotherms by dye, None where fibre fixes nothing."""

    said: Dyeing
    cloth: Chosen
    solver: Chosen
    isotherms: list[Chosen | None]
    picture: Chosen


@dataclass
class Loaded:
    """A scene with its plugins found and their configurations validated."""

    scene: Scene
    data: dict[str, Any]
    """The scene as read, with overrides applied, for recordings."""
    file: str
    """Name of the scene in errors."""
    lines: dict[yaml_lines.Path, int]
    files: SceneFiles
    models: list[Chosen]
    solver: Chosen | None
    """The integrator; None for a scene of dye alone."""
    colliders: list[Chosen]
    motions: list[Chosen | None]
    forces: list[Chosen]
    contacts: list[Chosen]
    """Contact of each body: its own, or the scene's."""
    chosen: list[Chosen]
    """All plugins of the scene, each once."""
    operations: list[Chosen] = field(default_factory=list)
    cloth_contact: Chosen | None = None
    """Contact of cloth with cloth, None for none."""
    dye: ChosenDye | None = None
    yarn_picture: Chosen | None = None
    """Drawing of pictures of yarns, if the scene chooses one."""
    overrides: tuple[str, ...] = ()
    path: Path = Path()
    """File of the scene; that of a mapping is in a temporary folder."""
    settled: tuple[Float, Float] | None = None
    """Start and rest of the coarse cloth (n, 3) [m], from a recording."""
    recorded_poses: Mapping[int, bytes] = field(default_factory=dict)
    """Messages with the poses of live bodies by frame, from a recording."""
    recorded_sizes: Mapping[str, int] = field(default_factory=dict)
    """Numbers of "vertices" or "cells", from a recording."""
    why: str = ""
    """Reason of the choice of solver and step, if `auto` chose them."""
    empty: tuple[str, ...] = ()
    """Fields that are written without a value."""

    @property
    def live(self) -> tuple[str, ...]:
        """Names of the live bodies, whose poses come from outside during the run."""
        pairs = zip(self.scene.bodies, self.motions, strict=True)
        return tuple(body.name for body, motion in pairs if motion is not None and hasattr(motion.plugin, "paced"))

    @property
    def paced(self) -> bool:
        """Whether frames wait for the clock without an option, since a live body follows it."""
        live_motions = (motion for motion in self.motions if motion is not None and hasattr(motion.plugin, "paced"))
        return any(motion.plugin.paced(motion.config) for motion in live_motions)

    @property
    def integrator(self) -> Chosen:
        """The integrator of a scene with moving cloth."""
        if self.solver is None:
            raise ValueError("a scene of dye alone has no integrator")
        return self.solver

    @property
    def dyed(self) -> ChosenDye:
        """The scene's dye. Raises BadInput for a scene without dye."""
        if self.dye is None:
            raise BadInput("the scene has no dye", self.file, remedy="add dye: {cloth: ..., dyes: [...]}")
        return self.dye

    @property
    def own_path(self) -> Path | None:
        """The user's file; None for a scene from a mapping or a recording."""
        return self.path if self.file == str(self.path) else None

    def value(self, field: str) -> Any:
        """Return the value of a field such as `forces.0.velocity`, or its default, in SI units; None without one."""
        data = self.scene.model_dump(mode="json")
        data["forces"] = [{"plugin": force.name, **force.config.model_dump(mode="json")} for force in self.forces]
        return item_at(data, tuple(map(number_or_name, parts_of(field))))

    def at(self, field: str, error: BadInput) -> BadInput:
        """Add this scene's file, line and the field's full path to an error."""
        names: set[object] = set()
        # Code that resolves a file's name, or reads the file, does not know the field.
        if error.file is not None:
            names = {error.file, *(name for name, path in self.files.used.items() if str(path) == error.file)}
        elif error.field is None and isinstance(error.value, str):
            names = {error.value}
        if names:
            texts = ((dotted(path), text) for path, text in yaml_lines.walk(self.data) if isinstance(text, str))
            within = f"{field}."
            field = next((place for place, text in texts if place.startswith(within) and text in names), field)
        return located(error, self.file, self.lines, field)

    @contextmanager
    def errors_at(self, field: str) -> Iterator[None]:
        """Place a BadInput of the `with` block at this field, as `at` does."""
        try:
            yield
        except BadInput as error:
            raise self.at(field, error) from None


def read(path: Path, overrides: Sequence[str] = (), roots: Iterable[Path] = (), named: str | None = None) -> Loaded:
    """Read, override and validate a scene file. Raises BadInput.

    `named` is the name in errors of a scene that is not a file of the user; they then name no line.
    """
    roots = tuple(roots)
    for root in roots:
        if not root.is_dir():
            raise BadInput("no such folder", field="--root", value=str(root), remedy="name an existing folder")
    data, lines, empty = yaml_lines.parse_all(read_scene(path).removeprefix(MARK), named or str(path))
    if named is not None:
        lines = dict.fromkeys(lines, UNNUMBERED)
    for item in overrides:
        lines = overridden(lines, apply_override(data, item))
    loaded = load(data, lines, named or str(path), files_of(path, roots))
    without_value = tuple(dotted(place) for place in empty if item_at(data, place) is None)
    return replace(loaded, overrides=tuple(overrides), path=path, empty=without_value)


def files_of(path: Path, roots: tuple[Path, ...] = ()) -> SceneFiles:
    """Return the files that a scene may name: in its folder, in roots, and for a shipped scene in the shared folder."""
    folder, shared = path.resolve().parent, shipped.folder().resolve()
    return SceneFiles(folder, (*roots, shared) if shared in folder.parents else roots)


def _or_first(solver: Solver, first: str) -> Solver:
    """Return the solver, or `first` in place of `auto`."""
    return solver if solver.plugin != AUTO else Solver(plugin=first)


def _chosen_dye(dye: Dyeing, chosen: Callable[[str, Choice, yaml_lines.Path], Chosen]) -> ChosenDye:
    return ChosenDye(
        dye,
        chosen("nuno.dye_cloths", dye.cloth, ("dye", "cloth")),
        chosen("nuno.dye_solvers", _or_first(dye.solver, FIRST_DYE), ("dye", "solver")),
        [
            chosen("nuno.isotherms", one.isotherm, ("dye", "dyes", i, "isotherm")) if one.isotherm else None
            for i, one in enumerate(dye.dyes)
        ],
        chosen("nuno.dye_pictures", dye.picture, ("dye", "picture")),
    )


def _contacts(scene: Scene, chosen: Callable[[str, Choice, yaml_lines.Path], Chosen]) -> list[Chosen]:
    """Return the contact of each body; the scene's is checked even where no body uses it."""
    if not scene.bodies:
        return []
    shared = chosen("nuno.contacts", scene.contact, ("contact",))
    own = {i: body.contact for i, body in enumerate(scene.bodies) if body.contact}
    own |= {i: Choice(plugin="sliding") for i in scene.slid_skins}
    places = {i: ("bodies", i, "contact") for i in own}
    return [chosen("nuno.contacts", own[i], places[i]) if i in own else shared for i in range(len(scene.bodies))]


def load(data: dict[str, Any], lines: dict[yaml_lines.Path, int], file: str, files: SceneFiles) -> Loaded:
    """Validate a scene's data and find its plugins. Raises BadInput."""
    check_compiler()
    with name_right_place(data):
        return _load(data, lines, file, files)


def _load(data: dict[str, Any], lines: dict[yaml_lines.Path, int], file: str, files: SceneFiles) -> Loaded:
    scene = validated(Scene, data, file, lines)
    all_chosen: list[Chosen] = []

    def chosen(group: str, choice: Choice, place: yaml_lines.Path) -> Chosen:
        all_chosen.append(choose_plugin(group, choice, place, file, lines))
        return all_chosen[-1]

    operations = [
        choose_operation(applied, ("operations", i), file, lines, files) for i, applied in enumerate(scene.operations)
    ]
    for i, (applied, operation) in enumerate(zip(scene.operations, operations, strict=True)):
        if applied.object is None and len(scene.objects) != 1 and not arranges(operation.plugin):
            remedy = nearest("", [part.name for part in scene.objects])
            error_of_object = BadInput("say which object it changes", remedy=remedy)
            raise located(error_of_object, file, lines, dotted(("operations", i, "object")))
        body, bodies = getattr(operation.config, "body", None), [body.name for body in scene.bodies]
        if body is not None and body not in bodies:
            remedy = nearest(body, bodies) if bodies else "give the scene the body"
            error_of_body = BadInput("there is no such body", value=body, remedy=remedy)
            raise located(error_of_body, file, lines, dotted(("operations", i, "body")))
    all_chosen += operations
    meeting = scene.cloth_contact if scene.moves and isinstance(scene.cloth_contact, ClothContact) else None
    return Loaded(
        scene,
        data,
        file,
        lines,
        files,
        models=[chosen("nuno.models", o.model, ("objects", i, "model")) for i, o in enumerate(scene.objects)],
        solver=chosen("nuno.integrators", _or_first(scene.solver, FIRST), ("solver",)) if scene.moves else None,
        colliders=[chosen("nuno.colliders", b.collider, ("bodies", i, "collider")) for i, b in enumerate(scene.bodies)],
        motions=[
            chosen("nuno.motions", b.motion, ("bodies", i, "motion")) if b.motion else None
            for i, b in enumerate(scene.bodies)
        ],
        forces=[chosen("nuno.forces", f, ("forces", i)) for i, f in enumerate(scene.forces)],
        operations=operations,
        cloth_contact=chosen("nuno.cloth_contacts", meeting, ("cloth_contact",)) if meeting is not None else None,
        chosen=all_chosen,
        contacts=_contacts(scene, chosen),
        dye=_chosen_dye(scene.dye, chosen) if scene.dye is not None else None,
        yarn_picture=chosen("nuno.yarn_pictures", scene.view.yarns, ("view", "yarns")) if scene.view.yarns else None,
    )


# The coarse version of a scene, in which its cloth comes to rest first.

SPEED = 2e-3
"""Speed below which cloth rests [m/s], unless the scene has one."""


def coarser(loaded: Loaded) -> Loaded | None:
    """Return the scene with its models on fewer vertices, until rest; None where no model allows that."""
    models = list(loaded.models)
    for i, model in enumerate(models):
        make_coarser = getattr(model.plugin, "coarser", None)
        config = make_coarser(model.config) if make_coarser else None
        models[i] = model if config is None else replace(model, config=config)
    if models == loaded.models:
        return None
    kept = [i for i, operation in enumerate(loaded.operations) if arranges(operation.plugin)]
    operations = [loaded.scene.operations[i] for i in kept]
    speed = loaded.scene.rest_speed or SPEED
    update = {"until": "rest", "rest_speed": speed, "operations": operations, "dye": None}
    scene = loaded.scene.model_copy(update=update)
    return replace(loaded, scene=scene, models=models, operations=[loaded.operations[i] for i in kept], dye=None)


# The right place of a misplaced field, such as the colour of an object inside its model.

DEEPEST = 4
"""Most levels of nested fields that are searched."""
MOST = 2
"""Most places that an error names: more would not help."""


@contextmanager
def name_right_place(data: Any) -> Iterator[None]:
    """Add the places that have a field of this name to the error of an unknown field."""
    try:
        yield
    except BadInput as error:
        place, _, name = (error.field or "").rpartition(".")
        places = belongs(name, place, data) if error.problem == NO_FIELD else []
        meant = re.search(r"did you mean '(\w+)'", error.remedy or "")
        if not places or (meant and meant[1].lower() == name.lower()):  # here it has other capitals
            raise
        raise replace(error, remedy=f"it is a field of {' or '.join(places)}: move it there") from None


def belongs(name: str, place: str, data: Any) -> list[str]:
    """Return the parts of a scene nearest to a place that have a field of this name; [] if there are many.

    Parts that the scene lacks, as dye, are named only for its own fields: those of another part are not meant for them.
    """
    distances: dict[str, int] = {}
    here = place.split(".") if place else []
    for path, fields in _nested_parts((Scene,), data if isinstance(data, dict) else {}, (), not here):
        sibling = [re.sub(r"\[\d+\]", "[]", text) for text in (dotted(path), place)]  # of a list: it has its own
        if name in fields and dotted(path) != place and sibling[0] != sibling[1]:
            parts = dotted(path).split(".") if path else []
            shared = sum(1 for _ in takewhile(lambda pair: pair[0] == pair[1], zip(here, parts, strict=False)))
            distances[dotted(path) or "the scene itself"] = len(here) + len(parts) - 2 * shared
    nearest = [path_text for path_text, distance in distances.items() if distance == min(distances.values())]
    return nearest if len(nearest) <= MOST else []


def _nested_parts(
    models: tuple[type[BaseModel], ...], data: dict[str, Any], path: FieldPath, absent: bool
) -> Iterator[tuple[FieldPath, set[str]]]:
    """Yield the path of each mapping that a scene has, or with `absent` could have, and its possible fields."""
    fields = {name: (model, field) for model in models for name, field in model.model_fields.items()}
    yield path, set(fields)
    if len(path) >= DEEPEST:
        return
    for name, (model, information) in fields.items():
        value, group = data.get(name), PLACES.get((model.__name__, name))
        models_inside = models_in(information.annotation)[:1]
        items = list(enumerate(value)) if isinstance(value, list) else [(None, value)]
        for number, item in items:
            inner = (*path, name) if number is None else (*path, name, number)
            if group and isinstance(item, dict):
                yield from _nested_parts((*models_inside, *_config_of(group, item)), item, inner, absent)
            elif item is None and information.get_default(call_default_factory=True) is None and not absent:
                continue
            elif models_inside and not group and isinstance(item, dict | None):
                yield from _nested_parts(tuple(models_inside), item or {}, inner, absent)


def _config_of(group: str, choice: dict[str, Any]) -> list[type[BaseModel]]:
    """Return the configuration class of the named plugin; [] if there is no such plugin."""
    try:
        return [registry.load(group, str(choice.get("plugin"))).Config]
    except BadInput:
        return []
