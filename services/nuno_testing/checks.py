"""The checks of each kind of plugin, by entry-point group: those of all, and its own."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping

import pytest
from pydantic import ValidationError

from nuno import registry
from nuno_testing import bodies, cloth, contacts, dye, forces, integrators, renderers, rides
from nuno_testing.subject import Subject


def answers_to_its_entry_point(subject: Subject) -> None:
    """It has the name under which it is installed, and holds no state of its own."""
    plugin = registry.installed(subject.group)[subject.name].load()()
    assert plugin.name == subject.name
    assert vars(plugin) == {}


def refuses_unknown_fields_by_name(subject: Subject) -> None:
    """A mistyped field is not passed over in silence; what it takes has a JSON Schema, and can be written."""
    config = subject.plugin.Config
    with pytest.raises(ValidationError, match="no_such_field"):
        config.model_validate(subject.config.model_dump(exclude_unset=True) | {"no_such_field": 1})
    schema = json.loads(json.dumps(config.model_json_schema()))
    assert schema["additionalProperties"] is False
    assert set(schema.get("properties", {})) == set(config.model_fields)
    assert config.model_validate_json(subject.config.model_dump_json(exclude_unset=True)) == subject.config


ALL = (answers_to_its_entry_point, refuses_unknown_fields_by_name)
OWN: Mapping[str, tuple[Callable[[Subject], None], ...]] = {
    "nuno.models": cloth.MODELS,
    "nuno.operations": cloth.OPERATIONS,
    "nuno.forces": forces.FORCES,
    "nuno.integrators": integrators.INTEGRATORS + rides.RIDES,
    "nuno.colliders": bodies.COLLIDERS,
    "nuno.motions": bodies.MOTIONS,
    "nuno.contacts": contacts.CONTACTS,
    "nuno.renderers": renderers.RENDERERS,
    "nuno.dye_solvers": dye.SOLVERS,
    "nuno.isotherms": dye.ISOTHERMS,
}
"""Of other kinds only what holds for all is looked at."""


def checks_of(group: str) -> tuple[Callable[[Subject], None], ...]:
    """The checks that a kind of plugin goes through."""
    return ALL + OWN.get(group, ())
