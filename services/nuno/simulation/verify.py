"""The cloth of a recording, stepped again."""

from __future__ import annotations

from collections.abc import Sequence

from nuno.collision.bodies import build_bodies
from nuno.recording.reader import Recording
from nuno.recording.recorded import Arrays, Recorded
from nuno.recording.restore import control_events
from nuno.scene.scene_file import Loaded
from nuno.simulation.resume import take_up
from nuno.simulation.run import Simulation
from nuno.verify import Again, remembered
from nuno.wire.arrays import decode_points, encode_points
from nuno_schemas.bodies import Poses
from nuno_schemas.messages import CHECKPOINT, STATE, STATUS
from nuno_schemas.system import Forces


class ClothAgain(Again):
    """A simulation with the control events of a recording."""

    part = "cloth"
    status, published, checkpoint = STATUS.name, STATE.name, CHECKPOINT.name

    def __init__(self, recording: Recording, loaded: Loaded, threads: int, start: Recorded | None = None) -> None:
        """From a checkpoint's message on, or else from the start. Raises BadInput."""
        self.changes = [event for event in control_events(recording) if event.text in ("set", "add")]
        """Still to be made."""
        self.bodies = build_bodies(loaded) if loaded.scene.bodies else None
        self.rate = loaded.scene.frame_rate
        self.poses = self.bodies.poses(0.0) if self.bodies else None
        self.simulation = Simulation(loaded, self.bodies.geometry if self.bodies else None, self.poses, threads)
        self._recording = recording
        if start is not None:
            point = recording.checkpoint(start)
            take_up(self.simulation, recording, point)
            self.changes = [event for event in self.changes if event.frame > point.frame]
            self.poses = self._poses(point.frame)
        self.simulation.measure(self.poses)

    @property
    def frame(self) -> int:
        """See `Again`."""
        return self.simulation.frame

    @property
    def t(self) -> float:
        """See `Again`."""
        return self.simulation.t

    def go_to(self, frame: int) -> None:
        """See `Again`."""
        while self.frame < frame:
            self.change()
            end = self._poses(self.frame + 1)
            self.simulation.advance(self.poses, end)
            self.poses = end

    def _poses(self, frame: int) -> Poses | None:
        return self.bodies.poses(frame / self.rate) if self.bodies else None

    def forces(self) -> Forces:
        """What acts in the present state."""
        after = self._poses(self.frame + 1)
        return self.simulation.forces(None if after is None or self.poses is None else (self.poses, after))

    def change(self) -> None:
        """See `Again`; each change once, in their order. Those of dye are not the cloth's."""
        for event in [event for event in self.changes if event.frame == self.frame]:
            self.changes.remove(event)
            item = str(event.args["item"])
            if event.text == "set":
                self.simulation.set(item)
            elif event.service == "simulation":
                self.simulation.add(item)

    @property
    def changing(self) -> bool:
        """See `Again`."""
        return any(event.frame == self.frame for event in self.changes)

    def digest(self) -> str:
        """See `Again`."""
        return self.simulation.digest()

    def arrays(self) -> Arrays:
        """See `Again`."""
        state = {"position": self.simulation.state.x, "velocity": self.simulation.state.v}
        return state | remembered(self.simulation.memory.arrays)

    def shown(self, payload: bytes) -> tuple[Arrays, Arrays]:
        """See `Again`."""
        ours = decode_points(encode_points(self.simulation.state.x, self.t))
        return {"position": ours}, {"position": decode_points(payload)}

    def kept(self, message: Recorded) -> tuple[str, Arrays]:
        """See `Again`."""
        point = self._recording.checkpoint(message)
        return point.digest, {"position": point.x, "velocity": point.v} | remembered(point.memory)

    def name(self, quantity: str, index: Sequence[int]) -> str:
        """See `Again`."""
        return f"vertex {index[0]}, axis {'xyz'[index[1]]}"
