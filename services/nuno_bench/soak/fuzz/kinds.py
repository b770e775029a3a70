"""All kinds of input, by name."""

from __future__ import annotations

from nuno_bench.soak.fuzz.files import FILES
from nuno_bench.soak.fuzz.kind import Kind
from nuno_bench.soak.fuzz.messages import MESSAGES
from nuno_bench.soak.fuzz.recordings import RECORDINGS

KINDS: dict[str, Kind] = {kind.name: kind for kind in (*RECORDINGS, *FILES, *MESSAGES)}
