"""What the services of a run did between two moments: rates, who is behind, what was lost."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import asdict, dataclass

from nuno.wire.health import Health
from nuno.words import factor

HEADINGS = (
    "service", "frame", "frames/s", "behind", "ms", "out/s", "out MB/s", "in/s", "in MB/s", "waiting", "missing",
    "refused", "CPU", "memory", "process",
)  # fmt: skip


@dataclass(frozen=True)
class ServiceLine:
    """One service, over the time between two answers of it.

    behind is the number of frames that it has still to take in, and late what they take at the present
    rate [ms], None while the run stands still. processor is a share of one core, of the whole process.
    """

    service: str
    leads: bool
    frame: int
    t: float
    frames: float
    behind: int
    late: float | None
    sent: float
    sent_megabytes: float
    received: float
    received_megabytes: float
    waiting: int
    missing: int
    refused: int
    processor: float
    memory: int
    process: str


def compare(before: Mapping[str, Health], after: Mapping[str, Health]) -> list[ServiceLine]:
    """A line for each service that answered twice; who leads comes first."""
    both = sorted((h for h in after.values() if h.service in before), key=lambda h: (not h.leads, h.service))
    leader = max((h for h in both if h.leads), key=lambda h: h.frame, default=None)
    pace = _rate(before, leader, "frame") if leader is not None else 0.0
    return [_line(before, health, leader, pace) for health in both]


def _line(before: Mapping[str, Health], now: Health, leader: Health | None, pace: float) -> ServiceLine:
    behind = max(0, leader.frame - now.frame) if leader is not None and now.frame >= 0 else 0
    return ServiceLine(
        now.service,
        now.leads,
        now.frame,
        now.t,
        _rate(before, now, "frame") if now.frame >= 0 else 0.0,
        behind,
        0.0 if not behind else 1e3 * behind / pace if pace > 0.0 else None,
        _rate(before, now, "sent"),
        _rate(before, now, "sent_bytes") / 1e6,
        _rate(before, now, "received"),
        _rate(before, now, "received_bytes") / 1e6,
        now.waiting,
        now.missing,
        now.refused,
        _rate(before, now, "processor"),
        now.memory,
        f"{now.host}:{now.pid}",
    )


def _rate(before: Mapping[str, Health], now: Health, name: str) -> float:
    """Change of a count in a second."""
    old = before[now.service]
    seconds = now.time - old.time
    return (getattr(now, name) - getattr(old, name)) / seconds if seconds > 0.0 else 0.0


def head(run: str, lines: list[ServiceLine]) -> str:
    """Where the run is."""
    first = lines[0]
    if not first.leads:
        return f"{run}: before its first frame"
    speed = first.frames * first.t / first.frame if first.frame > 0 else 0.0
    pace = f"{first.frames:.1f} frames/s, {factor(speed)} real time" if first.frames else "standing still"
    return f"{run}: frame {first.frame}, t = {first.t:.3f} s; {pace}"


def table(lines: list[ServiceLine]) -> str:
    """Aligned columns; services of one process share its processor time and memory, which stand at the first."""
    rows, seen = [list(HEADINGS)], set[str]()
    for line in lines:
        shared = line.process in seen
        seen.add(line.process)
        frame = str(line.frame) if line.frame >= 0 else "-"
        late = "-" if line.late is None or line.frame < 0 else f"{line.late:.0f}"
        cells = [line.service, frame, f"{line.frames:.1f}", str(line.behind), late]
        cells += [f"{line.sent:.1f}", f"{line.sent_megabytes:.2f}", f"{line.received:.1f}"]
        cells += [f"{line.received_megabytes:.2f}", *(str(n) for n in (line.waiting, line.missing, line.refused))]
        cells += ['"', '"'] if shared else [f"{line.processor:.0%}", f"{line.memory / 2**20:.0f} MiB"]
        rows.append([*cells, line.process])
    return align(rows, (0, len(HEADINGS) - 1))


def align(rows: Sequence[Sequence[str]], left: Collection[int]) -> str:
    """Lines of cells; columns are flush right, those of `left` flush left."""
    widths = [max(len(row[column]) for row in rows) for column in range(len(rows[0]))]
    pad = [
        [c.ljust(w) if i in left else c.rjust(w) for i, (c, w) in enumerate(zip(row, widths, strict=True))]
        for row in rows
    ]
    return "\n".join("  ".join(row).rstrip() for row in pad)


def as_json(run: str, lines: list[ServiceLine]) -> dict[str, object]:
    """For other programs."""
    return {"run": run, "services": [asdict(line) for line in lines]}
