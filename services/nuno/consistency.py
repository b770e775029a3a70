"""What the services of a run must have in common, wherever each has read it: the scene, its files, versions.

Each service reads the scene itself, on its own host or a moment later than another; where one has another scene, the
run would still go on, and its recording would not tell what was simulated.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from typing import Any

import zenoh

from nuno.bus.messages import Bus
from nuno.bus.query import Query
from nuno.scene.files import stamp_of
from nuno.scene.override import item_at, number_or_name, parts_of
from nuno.scene.provenance import assets, plugins, versions
from nuno.scene.scene_file import Loaded
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


Premises = dict[str, Any]
"""What one service starts from: each value of its scene as validated, in SI units and with all defaults, by its field;
`file NAME`, the sha256 of what the scene names; `version NAME`, of a package or of a plugin that the scene names;
whether it `resumes`; and whether solver and step are `decided`, which not every service needs. JSON can say it all."""


def premises_of(loaded: Loaded, resumes: bool) -> Premises:
    """Those of a service that has read this scene. Raises BadInput for a file that has changed since, or is gone."""
    scene = loaded.scene.model_dump(mode="json")
    for chosen in loaded.chosen:
        # What a plugin is given stands in the scene as it was written: 10 cm here, 0.1 there.
        place = tuple(map(number_or_name, parts_of(chosen.field)))
        item_at(scene, place).update(chosen.config.model_dump(mode="json"))
    packages = {name: version for name, version in versions().items() if name in CHANGE_RESULTS}
    found = leaves(scene) | {"decided": not loaded.scene.undecided, "resumes": resumes}
    found |= {f"version {name}": version for name, version in (packages | plugins(loaded)).items()}
    for name, path in assets(loaded).items():
        try:
            if stamp_of(path) != loaded.files.stamps[name]:
                raise BadInput("it has changed since it was read", str(path), remedy="start the run again")
            with path.open("rb") as stream:
                found[f"file {name}"] = hashlib.file_digest(stream, "sha256").hexdigest()
        except OSError as error:
            raise BadInput(f"cannot be read: {error.strerror}", str(path)) from None
    return found


def leaves(value: object, field: str = "") -> Premises:
    """Each value that is no mapping or list by its field, as `bodies[0].collider.radius`."""
    if isinstance(value, Mapping):
        items = [(f"{field}.{name}" if field else str(name), one) for name, one in value.items()]
    elif isinstance(value, list):
        items = [(f"{field}[{i}]", one) for i, one in enumerate(value)]
    else:
        return {field: value}
    return {name: leaf for inner, one in items for name, leaf in leaves(one, inner).items()}


def offer_premises(bus: Bus, loaded: Loaded, resumes: bool) -> None:
    """Answer whoever asks, in a thread of the session; nothing is read for a run in which nobody does."""
    key = bus.key(f"{PREMISES}/{bus.service}")

    def answer(query: zenoh.Query) -> None:
        question = Query(PREMISES, key, query)
        try:
            question.answer_json(premises_of(loaded, resumes))
        except BadInput as error:
            question.answer_json({"problem": str(error)})

    bus.offers.append(bus.session.declare_queryable(key, answer))


def check_premises(bus: Bus, services: set[str], loaded: Loaded, resumes: bool) -> list[str]:
    """Have each service start from the same as `loaded`; what is to be said of versions that differ.

    Raises BadInput for another scene or file, RunFailed, with the service as its peer, where one does not answer.
    """
    questions = {name: bus.ask_ahead(f"{PREMISES}/{name}", timeout=PATIENCE) for name in sorted(services)}
    own = json.loads(json.dumps(premises_of(loaded, resumes)))  # as the others come
    notes = []
    for name, asked in questions.items():
        try:
            theirs = json.loads(asked.answer())
        except RunFailed as error:
            raise RunFailed(str(error), peer=name) from None
        if "problem" in theirs:
            raise BadInput(f"the {name} service cannot begin: {theirs['problem']}")
        notes += compare(name, theirs, own)
        # What the supervisor's host lacks, the others must agree on.
        own = {field: value for field, value in theirs.items() if field.startswith("file ")} | own
    return notes


def compare(service: str, theirs: Premises, own: Premises) -> list[str]:
    """Versions that differ, in words. Raises BadInput for the first value of the scene, or file, that does."""
    choosing = () if theirs.get("decided") and own["decided"] else ("solver", "accuracy", "dye.solver")
    notes = []
    for field in {**theirs, **own}:
        there, here = theirs.get(field, NOTHING), own.get(field, NOTHING)
        kind, _, name = field.partition(" ")
        if there == here or field == "decided" or (kind in ("file", "version") and NOTHING in (there, here)):
            continue
        if kind == "version":
            text = f"the {service} service has {name} {there}, the run {here}"
            notes.append(f"{text}: equal bits are promised for equal versions")
        elif kind == "file":
            problem = f"the {service} service has read another file of that name"
            raise BadInput(problem, value=name, remedy=REMEDY)
        elif field == "resumes" and service in RESUMING:
            problem = f"the {service} service {'goes on from a recording' if there else 'starts anew'}"
            remedy = "give the run and its simulation, dye and recorder the same --resume"
            raise BadInput(f"{problem}, the run does not", field="--resume", remedy=remedy)
        elif field != "resumes" and not field.startswith(choosing):
            problem, limit = f"the {service} service has read another scene", f"{here!r:.60}, as the run has it"
            raise BadInput(problem, field=field, value=there, limit=limit, remedy=REMEDY)
    return notes
