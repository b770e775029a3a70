"""What the services of a run must have in common, wherever each has read it: the scene, its files, versions.

Each service reads the scene itself, on its own host or a moment later than another; where one has another scene, the
run would still go on, and its recording would not tell what was simulated.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping
from typing import Any

import zenoh
from pydantic import BaseModel

from nuno.scene.files import stamp_of
from nuno.scene.override import item_at, number_or_name, parts_of
from nuno.scene.provenance import assets, chosen_by, plugins, versions
from nuno.scene.scene_file import Loaded
from nuno.wire.bus import Bus
from nuno.wire.question import Question
from nuno_schemas.errors import BadInput, RunFailed

PREMISES = "premises"
PATIENCE = 60.0
"""How long an answer may take [s]: large files are read for it."""
CHANGE_RESULTS = ("python", "nuno", "numpy", "numba", "llvmlite")
"""Packages whose versions can change a result."""
RESUMING = ("simulation", "dye", "recorder")
"""Services that go on from a recording where the run does."""
NOTHING = "nothing"
REMEDY = "give its host the same scene and files, and each service the same --set and --root"


class Premises(BaseModel):
    """What one service starts from."""

    scene: dict[str, Any]
    """As validated, in SI units, with all defaults."""
    decided: bool
    """Whether solver and step are chosen: not every service needs them."""
    resumes: bool
    files: dict[str, str]
    """sha256 of what the scene names, by its name there."""
    versions: dict[str, str]
    """Of packages, and of the plugins that the scene names."""


def premises_of(loaded: Loaded, resumes: bool) -> Premises:
    """Those of a service that has read this scene. Raises BadInput for a file that has changed since, or is gone."""
    scene = loaded.scene.model_dump(mode="json")
    for chosen in (*chosen_by(loaded), *filter(None, [loaded.yarn_picture])):
        # What a plugin is given stands in the scene as it was written: 10 cm here, 0.1 there.
        place = tuple(map(number_or_name, parts_of(chosen.field)))
        item_at(scene, place).update(chosen.config.model_dump(mode="json"))
    packages = {name: version for name, version in versions().items() if name in CHANGE_RESULTS}
    files = {}
    for name, path in assets(loaded).items():
        try:
            if stamp_of(path) != loaded.files.stamps[name]:
                raise BadInput("it has changed since it was read", str(path), remedy="start the run again")
            with path.open("rb") as stream:
                files[name] = hashlib.file_digest(stream, "sha256").hexdigest()
        except OSError as error:
            raise BadInput(f"cannot be read: {error.strerror}", str(path)) from None
    return Premises(
        scene=scene,
        decided=not loaded.scene.undecided,
        resumes=resumes,
        files=files,
        versions=packages | plugins(loaded),
    )


def offer_premises(bus: Bus, loaded: Loaded, resumes: bool) -> None:
    """Answer whoever asks, in a thread of the session; nothing is read for a run in which nobody does."""
    key = bus.key(f"{PREMISES}/{bus.service}")

    def answer(query: zenoh.Query) -> None:
        question = Question(PREMISES, key, query)
        try:
            question.answer(premises_of(loaded, resumes).model_dump_json().encode())
        except BadInput as error:
            question.answer_json({"problem": str(error)})

    bus.offers.append(bus.session.declare_queryable(key, answer))


def check_premises(bus: Bus, services: set[str], loaded: Loaded, resumes: bool) -> list[str]:
    """Have each service start from the same as `loaded`; what is to be said of versions that differ.

    Raises BadInput for another scene or file, RunFailed, with the service as its peer, where one does not answer.
    """
    answers = {name: bus.ask_ahead(f"{PREMISES}/{name}", timeout=PATIENCE) for name in sorted(services)}
    own = Premises.model_validate_json(premises_of(loaded, resumes).model_dump_json())  # as the others come
    notes = []
    for name, answer in answers.items():
        try:
            said = json.loads(answer())
        except RunFailed as error:
            raise RunFailed(str(error), peer=name) from None
        if "problem" in said:
            raise BadInput(f"the {name} service cannot begin: {said['problem']}")
        theirs = Premises.model_validate(said)
        notes += compare(name, theirs, own)
        own.files = theirs.files | own.files  # what the supervisor's host lacks, the others must agree on
    return notes


def compare(service: str, theirs: Premises, own: Premises) -> list[str]:
    """Versions that differ, in words. Raises BadInput where scene or files do, with the first that does."""
    there_read, here_read = (
        one.scene if theirs.decided and own.decided else _undecided(one.scene) for one in (theirs, own)
    )
    for field, there, here in differences(there_read, here_read):
        problem, limit = f"the {service} service has read another scene", f"{here!r:.60}, as the run has it"
        raise BadInput(problem, field=field, value=there, limit=limit, remedy=REMEDY)
    for name in sorted(theirs.files.keys() & own.files.keys()):
        if theirs.files[name] != own.files[name]:
            problem = f"the {service} service has read another file of that name"
            raise BadInput(problem, value=name, remedy=REMEDY)
    if service in RESUMING and theirs.resumes != own.resumes:
        problem = f"the {service} service {'goes on from a recording' if theirs.resumes else 'starts anew'}"
        remedy = "give the run and its simulation, dye and recorder the same --resume"
        raise BadInput(f"{problem}, the run does not", field="--resume", remedy=remedy)
    shared = theirs.versions.keys() & own.versions.keys()
    return [
        f"the {service} service has {name} {theirs.versions[name]}, the run {own.versions[name]}: "
        "equal bits are promised for equal versions"
        for name in sorted(shared)
        if theirs.versions[name] != own.versions[name]
    ]


def _undecided(scene: Mapping[str, Any]) -> dict[str, Any]:
    """Without what is still to be chosen."""
    left = {name: value for name, value in scene.items() if name not in ("solver", "accuracy")}
    if isinstance(dye := left.get("dye"), dict):
        left["dye"] = {name: value for name, value in dye.items() if name != "solver"}
    return left


def differences(one: object, other: object, field: str = "") -> Iterator[tuple[str, object, object]]:
    """Each field whose value differs, as `bodies[0].collider.radius`, with both; "nothing" where there is none."""
    if isinstance(one, Mapping) and isinstance(other, Mapping):
        for name in dict.fromkeys((*one, *other)):
            inner = f"{field}.{name}" if field else str(name)
            yield from differences(one.get(name, NOTHING), other.get(name, NOTHING), inner)
    elif isinstance(one, list) and isinstance(other, list):
        for i in range(max(len(one), len(other))):
            each, its = (values[i] if i < len(values) else NOTHING for values in (one, other))
            yield from differences(each, its, f"{field}[{i}]")
    elif one != other:
        yield field, one, other
