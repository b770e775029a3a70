"""A query to a service."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Any

import zenoh


@dataclass
class Query:
    """One query to a service, which has to be answered exactly once."""

    name: str
    key: str
    query: zenoh.Query

    @property
    def payload(self) -> bytes:
        return self.query.payload.to_bytes() if self.query.payload is not None else b""

    def json(self) -> dict[str, Any]:
        """Return the payload as a mapping; anything else counts as empty."""
        try:
            value = json.loads(self.payload)
        except (ValueError, RecursionError):
            return {}
        return value if isinstance(value, dict) else {}

    def refuse(self, problem: str) -> None:
        """Reply with an error."""
        self.query.reply_err(problem)
        self.query.drop()

    def answer(self, payload: bytes) -> None:
        self.query.reply(self.key, payload)
        self.query.drop()

    def answer_json(self, value: dict[str, Any]) -> None:
        self.answer(json.dumps(value).encode())
