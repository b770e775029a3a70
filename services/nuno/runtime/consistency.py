"""Consistency of the services of a run: the same scene, files and versions in each.

Each service reads the scene itself, on its own host or a moment later than another; with another scene in one of them,
the run would still go on, and its recording would be wrong.
"""

from __future__ import annotations

import hashlib
import json
from typing import Any

import zenoh

from nuno.bus.messages import Bus, Query
from nuno.scene.files import stamp_of
from nuno.scene.override import item_at, number_or_name, parts_of
from nuno.scene.provenance import CHANGE_RESULTS, assets, plugins, versions
from nuno.scene.scene_file import Loaded
from nuno.scene.yaml_lines import dotted, walk
from nuno_schemas.errors import BadInput, RunFailed

PREMISES = "premises"
PATIENCE = 60.0
"""Timeout of a reply [s], for which large files may be read."""
RESUMING = ("simulation", "dye", "collision", "recorder")
"""Services that resume a recording if the run does."""
NOTHING = "nothing"
REMEDY = "give its host the same scene and files, and each service the same --set and --root"


Premises = dict[str, Any]
"""Inputs of one service: each validated value of its scene, in SI units and with all defaults, by its field;
`file NAME`, the sha256 of a file of the scene; `version NAME`, of a package or of a plugin of the scene;
whether it `resumes`; the service whose frames wait for the `clock`, "" for none; and whether solver and step are
`decided`, which not every service needs. All are JSON-able."""


def premises_of(loaded: Loaded, resumes: bool, real_time: bool = False) -> Premises:
    """Return the premises of a service with this scene. Raises BadInput for a file that has changed, or is gone."""
    scene = loaded.scene.model_dump(mode="json")
    for chosen in loaded.chosen:
        # A plugin's configuration is in the scene as it was written: 10 cm in one, 0.1 in another.
        place = tuple(map(number_or_name, parts_of(chosen.field)))
        item_at(scene, place).update(chosen.config.model_dump(mode="json"))
    packages = {name: version for name, version in versions().items() if name in CHANGE_RESULTS}
    premises: Premises = {dotted(place): leaf for place, leaf in walk(scene) if not isinstance(leaf, dict | list)}
    premises |= {"decided": not loaded.scene.undecided, "resumes": resumes}
    premises["clock"] = ("simulation" if loaded.scene.moves else "dye") if real_time else ""
    premises |= {f"version {name}": version for name, version in (packages | plugins(loaded)).items()}
    for name, path in assets(loaded).items():
        try:
            if stamp_of(path) != loaded.files.stamps[name]:
                raise BadInput("it has changed since it was read", str(path), remedy="start the run again")
            with path.open("rb") as stream:
                premises[f"file {name}"] = hashlib.file_digest(stream, "sha256").hexdigest()
        except OSError as error:
            raise BadInput(f"cannot be read: {error.strerror}", str(path)) from None
    return premises


def offer_premises(bus: Bus, loaded: Loaded, resumes: bool, real_time: bool) -> None:
    """Answer queries for the premises, in a thread of the session; files are read only for a query."""
    key = bus.key(f"{PREMISES}/{bus.service}")

    def answer(query: zenoh.Query) -> None:
        request = Query(PREMISES, key, query)
        try:
            request.answer_json(premises_of(loaded, resumes, real_time))
        except BadInput as error:
            request.answer_json({"problem": str(error)})

    bus.offers.append(bus.session.declare_queryable(key, answer))


def check_premises(bus: Bus, services: set[str], loaded: Loaded, resumes: bool, real_time: bool) -> list[str]:
    """Check that each service has the same premises as `loaded`; return notes on different versions.

    Raises BadInput for another scene or file, RunFailed, with the service as its peer, where one does not answer.
    """
    replies = {name: bus.ask_ahead(f"{PREMISES}/{name}", timeout=PATIENCE) for name in sorted(services)}
    ours = json.loads(json.dumps(premises_of(loaded, resumes, real_time)))  # in the form of the replies
    notes = []
    for name, reply in replies.items():
        try:
            theirs = json.loads(reply.answer())
        except RunFailed as error:
            raise RunFailed(str(error), peer=name) from None
        if "problem" in theirs:
            raise BadInput(f"the {name} service cannot begin: {theirs['problem']}")
        notes += compare(name, theirs, ours)
        # Files that the supervisor's host lacks must agree between the others.
        ours = {field: value for field, value in theirs.items() if field.startswith("file ")} | ours
    return notes


def compare(service: str, theirs: Premises, ours: Premises) -> list[str]:
    """Return notes on different versions. Raises BadInput for the first different value of the scene, or file."""
    choosing = () if theirs.get("decided") and ours["decided"] else ("solver", "accuracy", "dye.solver")
    notes = []
    for field in {**theirs, **ours}:
        there, here = theirs.get(field, NOTHING), ours.get(field, NOTHING)
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
        elif field == "clock" and service == here:
            problem, remedy = f"the {service} service does not wait for the clock", "give it the same --real-time"
            raise BadInput(problem, field="--real-time", remedy=remedy)
        elif field not in ("resumes", "clock") and not field.startswith(choosing):
            problem, limit = f"the {service} service has read another scene", f"{here!r:.60}, as the run has it"
            raise BadInput(problem, field=field, value=there, limit=limit, remedy=REMEDY)
    return notes
