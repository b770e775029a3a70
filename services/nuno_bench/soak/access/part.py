"""Nobody gets in: those without the right certificate, those with one for something else, and what listens at all."""

from __future__ import annotations

import tempfile
from pathlib import Path

from nuno.access.rights import read_rights
from nuno.wire.sessions import free_port, hub, spoke
from nuno_bench.report.result import Result
from nuno_bench.soak.access import sockets
from nuno_bench.soak.access.guarded import Guarded, guarded_run, outsiders, posing_router
from nuno_bench.soak.access.intruders import FORGED, MESSAGES, Tally, Witness, ask, attempt
from nuno_schemas.errors import BadInput

GOT = "messages read, requests taken, forgeries delivered"


def run(quick: bool, seed: int) -> list[Result]:
    """All attempts on one run, and the sockets of runs as a user starts them."""
    del seed
    with tempfile.TemporaryDirectory(prefix="nuno-access-") as name:
        return [*attempts(Path(name)), *sockets.measure(Path(name), quick)]


def attempts(where: Path) -> list[Result]:
    """A row for each who tries, and one for each thing that must work, without which they would prove nothing."""
    with guarded_run(where) as guarded, spoke(guarded.endpoint, guarded.config("observer")) as session:
        witness = Witness(guarded, session)
        results = _what_works(witness)
        for case, (endpoint, config) in outsiders(guarded, where).items():
            results.append(_row(case, attempt(witness, endpoint, config), outside=True))
        for role, rights in read_rights().items():
            tally = attempt(witness, guarded.endpoint, guarded.config(role), rights)
            results.append(_row(f"the {role}'s certificate, for all that is not its own", tally))
        results.append(_posing(guarded, where))
    return [*results, *_unharmed(guarded)]


def _row(case: str, tally: Tally, outside: bool = False) -> Result:
    if outside and tally.connected:
        return Result(case, GOT, "", failure="was let in")
    if not outside and not tally.connected:
        return Result(case, GOT, "", failure="was not let in at all: nothing was tried")
    return Result(case, GOT, "", (tally.total,), bar=0, at_most=True)


def _what_works(witness: Witness) -> list[Result]:
    """What the same attempts give those who may."""
    guarded = witness.guarded
    read = witness.wait()
    with spoke(guarded.endpoint, guarded.config("operator")) as session:
        taken = ask(session, guarded.run, "control")
    with spoke(guarded.endpoint, guarded.config("simulation")) as session:
        session.put("nuno/another/sim/state", FORGED)
        witness.wait()
    return [
        Result("observer", "messages read", "", (read,), bar=MESSAGES),
        Result("operator", "requests taken", "", (taken,), bar=1),
        Result("simulation", "messages delivered", "", (witness.forged,), bar=1),
    ]


def _posing(guarded: Guarded, where: Path) -> Result:
    """A role's certificate in the hand of one who listens in the router's place."""
    endpoint = f"tls/localhost:{free_port()}"
    connected = 0
    with hub(endpoint, str(posing_router(guarded, where, "observer"))):
        try:
            with spoke(endpoint, guarded.config("simulation")):
                connected += 1
        except BadInput:
            pass
    case = "the observer's certificate, in the place of the router"
    return Result(case, "services that connect", "", (connected,), bar=0, at_most=True)


def _unharmed(guarded: Guarded) -> list[Result]:
    """What the run noticed of it all."""
    outcome = guarded.outcome
    if outcome is None or outcome.state != "stopped":
        why = "it did not end" if outcome is None else f"{outcome.state}: {outcome.problem}"
        return [Result("the run meanwhile", "foreign messages that reached a service", "", failure=why)]
    refused = sum(sum(said.get("refused", {}).values()) for said in outcome.services.values())
    missing = sum(sum(said.get("missing", {}).values()) for said in outcome.services.values())
    case = "the run meanwhile"
    return [
        Result(case, "foreign messages that reached a service", "", (refused,), bar=0, at_most=True),
        Result(case, "own messages lost", "", (missing,), bar=0, at_most=True),
    ]
