"""The part `fuzz`: whatever is read is accepted whole or refused in words, soon and in little memory."""

from __future__ import annotations

from soak.fuzz.files import FILES
from soak.fuzz.kind import Kind
from soak.fuzz.messages import MESSAGES
from soak.fuzz.recordings import RECORDINGS

KINDS: dict[str, Kind] = {kind.name: kind for kind in (*RECORDINGS, *FILES, *MESSAGES)}
"""All kinds of input, by name."""
