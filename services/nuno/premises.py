"""What the services of a run must have in common, wherever each has read it: the scene, its files, versions.

Each service reads the scene itself, on its own host or a moment later than another; where one has another scene, the
run would still go on, and its recording would not tell what was simulated.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping
from typing import Any

import zenoh
from pydantic import BaseModel

from nuno.recording.provenance import PACKAGES, assets, versions
from nuno.scene.scene_file import Loaded
from nuno.wire.bus import Bus
from nuno.wire.question import Question
from nuno_schemas.errors import BadInput, RunFailed

PREMISES = "premises"
PATIENCE = 60.0
"""How long an answer may take [s]: large files are read for it."""
NOTHING = "nothing"


class Premises(BaseModel):
    """What one service starts from."""

    scene: dict[str, Any]
    """As validated, defaults filled in."""
    decided: bool
    """Whether solver and step are chosen: not every service needs them."""
    files: dict[str, str]
    """sha256 of what the scene names, by its name there."""
    versions: dict[str, str]


def premises_of(loaded: Loaded) -> Premises:
    """Those of a service that has read this scene. Raises OSError for a file that is gone."""
    files = {}
    for name, path in assets(loaded).items():
        with path.open("rb") as stream:
            files[name] = hashlib.file_digest(stream, "sha256").hexdigest()
    found = {name: version for name, version in versions().items() if name in ("python", *PACKAGES)}
    return Premises(
        scene=loaded.scene.model_dump(mode="json"), decided=not loaded.scene.undecided, files=files, versions=found
    )


def offer_premises(bus: Bus, loaded: Loaded) -> None:
    """Answer whoever asks, in a thread of the session; nothing is read for a run in which nobody does."""
    key = bus.key(f"{PREMISES}/{bus.service}")

    def answer(query: zenoh.Query) -> None:
        question = Question(PREMISES, key, query)
        try:
            question.answer(premises_of(loaded).model_dump_json().encode())
        except OSError as error:
            question.refuse(str(error))

    bus.offers.append(bus.session.declare_queryable(key, answer))


def check_premises(bus: Bus, services: set[str], loaded: Loaded) -> list[str]:
    """Have each service start from the same as `loaded`; what is to be said of versions that differ.

    Raises BadInput for another scene or file, RunFailed where a service does not answer.
    """
    own = Premises.model_validate_json(premises_of(loaded).model_dump_json())  # as the others come
    answers = {name: bus.ask_ahead(f"{PREMISES}/{name}", timeout=PATIENCE) for name in sorted(services)}
    notes = []
    for name, answer in answers.items():
        try:
            theirs = Premises.model_validate_json(answer())
        except RunFailed as error:
            raise RunFailed(str(error), peer=name) from None
        except ValueError:
            raise RunFailed(f"the answer of {PREMISES}/{name} cannot be read", peer=name) from None
        notes += compare(name, theirs, own)
    return notes


def compare(service: str, theirs: Premises, own: Premises) -> list[str]:
    """Versions that differ, in words. Raises BadInput where scene or files do, with the first that does."""
    remedy = "give its host the same scene and files, and each service the same --set and --root"
    there_read, here_read = (
        one.scene if theirs.decided and own.decided else _undecided(one.scene) for one in (theirs, own)
    )
    for field, there, here in differences(there_read, here_read):
        problem, limit = f"the {service} service has read another scene", f"{here!r}, as the run has it"
        raise BadInput(problem, field=field, value=there, limit=limit, remedy=remedy)
    for name in sorted(theirs.files.keys() & own.files.keys()):
        if theirs.files[name] != own.files[name]:
            raise BadInput(f"the {service} service has read another file of that name", value=name, remedy=remedy)
    return [
        f"the {service} service has {name} {there}, the run {here}: equal bits are promised for equal versions"
        for name, there, here in differences(theirs.versions, own.versions)
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
    elif isinstance(one, list) and isinstance(other, list) and len(one) == len(other):
        for i, (each, its) in enumerate(zip(one, other, strict=True)):
            yield from differences(each, its, f"{field}[{i}]")
    elif one != other:
        yield field, one, other
