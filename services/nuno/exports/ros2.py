"""Export of a recording as a ROS 2 bag, rosbag2 with MCAP: cloth and bodies as markers, points, transforms, numbers."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from nuno.exports.meshes import CLOTH, Shape, Turn, follow, show_recording
from nuno.output_files import Progress, check_folder, load_extra, writing_folder
from nuno.recording.reader import Recording, opened
from nuno_schemas.fabric import Float
from nuno_schemas.messages import BODIES

VERSION = 8
"""Version of metadata.yaml: the last that Humble reads, and readable by later releases."""
LINE = 0.002
"""Width of a net's links [m]."""
MARKERS, POINTS, TRANSFORMS = (
    "visualization_msgs/msg/MarkerArray",
    "sensor_msgs/msg/PointCloud2",
    "tf2_msgs/msg/TFMessage",
)
NUMBER = "std_msgs/msg/Float64"
LASTING = ("/tf_static", "/bodies")
"""Topics of a single message, which late subscribers also get."""
Sent = tuple[str, str, int, Any]
"""Topic, type, time [ns], message."""


def export_ros2(source: Recording | Path | str, path: Path, progress: Progress | None = None) -> Path:
    """Write a whole recording as a bag: a folder with metadata.yaml and an MCAP file.

    /cloth has a MarkerArray per frame, with one marker per object, /cloth_points a PointCloud2 of its vertices; /bodies
    the rigid bodies, once, in their frames, which /tf moves; /skins the bending bodies, each frame; /series/NAME the
    columns of `Recording.series` as Float64. Times are those of the scene. Raises BadInput if the path exists, for a
    recording of dye alone, positions that are not finite, damage, and if rosbags is not installed.
    """
    check_ros2(path)
    from rosbags.rosbag2 import CompressionMode, StoragePlugin, Writer
    from rosbags.rosbag2.enums import CompressionFormat

    with opened(source) as recording, writing_folder(path) as new:
        bag = Writer(new, version=VERSION, storage_plugin=StoragePlugin.MCAP)
        bag.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
        export, connections = _Export(recording), dict[str, Any]()
        with bag:
            for topic, kind, at, message in export.messages(progress):
                if topic not in connections:
                    offered = [_lasting()] if topic in LASTING else []
                    more = {"typestore": export.store, "offered_qos_profiles": offered}
                    connections[topic] = bag.add_connection(topic, kind, **more)
                bag.write(connections[topic], at, export.store.serialize_cdr(message, kind))
    return path


def check_ros2(path: Path) -> None:
    """Raise BadInput if the path exists, and if rosbags is not installed."""
    check_folder(path)
    load_extra(("rosbags",), "ROS 2 bags need rosbags", "ros", "export for Foxglove, --foxglove out.mcap")


def _lasting() -> Any:
    """Return the quality of service: reliable, and kept for late subscribers."""
    from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime

    never = QosTime(9223372036, 854775807)  # as rmw's RMW_DURATION_INFINITE
    return Qos(
        QosHistory.KEEP_LAST, 1, QosReliability.RELIABLE, QosDurability.TRANSIENT_LOCAL, never, never,
        QosLiveliness.AUTOMATIC, never, False,
    )  # fmt: skip


class _Export:
    """Converts a recording's messages to those of ROS 2 since Humble."""

    def __init__(self, recording: Recording) -> None:
        from rosbags.typesys import Stores, get_typestore

        self.recording, self.show, self.store = recording, show_recording(recording), get_typestore(Stores.ROS2_HUMBLE)

    def messages(self, progress: Progress | None) -> Iterator[Sent]:
        """Yield all messages, in order. Raises BadInput."""
        numbers, placed, show = self._numbers(), False, self.show
        for message, x in follow(self.recording, show, progress):
            at = message.log_time
            if message.topic == BODIES.name:
                if not placed and (rigid := show.rigid()):
                    yield "/bodies", MARKERS, at, self._markers(rigid, at)
                placed = True
                yield "/tf", TRANSFORMS, at, self._turns(show.turns(), at)
            if x is None:
                continue
            first, shapes = show.origin is None, show.cloth(x)
            if first:
                yield "/tf_static", TRANSFORMS, at, self._turns(show.fixed(), at)
            yield "/cloth", MARKERS, at, self._markers(shapes, at)
            yield "/cloth_points", POINTS, at, self._points(x - show.fixed()[1].translation, at)
            if skins := show.skins():
                yield "/skins", MARKERS, at, self._markers(skins, at)
            for topic, value in numbers.get(at, {}).items():
                yield topic, NUMBER, at, self._new(NUMBER, data=value)

    def _numbers(self) -> dict[int, dict[str, float]]:
        """Return the finite numbers of the recording's series by log time [ns] and topic, a valid ROS name."""
        series = self.recording.series()
        times = {number: at for at, (number, _) in self.recording.marks().items()}
        numbers: dict[int, dict[str, float]] = {}
        for name in series.keys() - {"frame", "t"}:
            topic = "/series/" + re.sub(r"\W", "_", name, flags=re.ASCII)
            for frame, value in zip(series["frame"].tolist(), series[name].tolist(), strict=True):
                if frame in times and np.isfinite(value):
                    numbers.setdefault(times[frame], {})[topic] = float(value)
        return numbers

    def _new(self, kind: str, **fields: Any) -> Any:
        return self.store.types[kind](**fields)

    def _stamp(self, at: int) -> Any:
        seconds, nanos = divmod(at, 10**9)
        return self._new("builtin_interfaces/msg/Time", sec=seconds, nanosec=nanos)

    def _header(self, at: int, frame: str) -> Any:
        return self._new("std_msgs/msg/Header", stamp=self._stamp(at), frame_id=frame)

    def _vector(self, kind: str, values: Sequence[float]) -> Any:
        return self._new(f"geometry_msgs/msg/{kind}", **dict(zip("xyz", values, strict=True)))

    def _quaternion(self, rotation: Sequence[float]) -> Any:
        return self._new("geometry_msgs/msg/Quaternion", **dict(zip("wxyz", rotation, strict=True)))

    def _turns(self, turns: Sequence[Turn], at: int) -> Any:
        stamped = []
        for turn in turns:
            shift = self._vector("Vector3", turn.translation)
            pose = self._new("geometry_msgs/msg/Transform", translation=shift, rotation=self._quaternion(turn.rotation))
            header = self._header(at, turn.parent)
            kind = "geometry_msgs/msg/TransformStamped"
            stamped.append(self._new(kind, header=header, child_frame_id=turn.child, transform=pose))
        return self._new(TRANSFORMS, transforms=stamped)

    def _markers(self, shapes: Sequence[tuple[str, Shape]], at: int) -> Any:
        return self._new(MARKERS, markers=[self._marker(shape, frame, at) for frame, shape in shapes])

    def _marker(self, shape: Shape, frame: str, at: int) -> Any:
        """Return the marker of a shape in a frame. A marker's triangles have three points each and share none."""
        kind = "visualization_msgs/msg/Marker"
        marker, corners = self.store.types[kind], shape.indices.reshape(-1).tolist()
        points = [self._vector("Point", point) for point in shape.x.astype(np.float32).tolist()]
        tints = [self._new("std_msgs/msg/ColorRGBA", r=r, g=g, b=b, a=1.0) for r, g, b in shape.colours.tolist()]
        sole = len(tints) == 1
        nothing = np.zeros(0, np.uint8)
        return marker(
            header=self._header(at, frame), ns=shape.name, id=0, action=marker.ADD, frame_locked=True,
            type=marker.TRIANGLE_LIST if shape.indices.shape[1] == 3 else marker.LINE_LIST,
            pose=self._new("geometry_msgs/msg/Pose", position=self._vector("Point", (0.0, 0.0, 0.0)),
                           orientation=self._quaternion((1.0, 0.0, 0.0, 0.0))),
            scale=self._vector("Vector3", (1.0, 1.0, 1.0) if shape.indices.shape[1] == 3 else (LINE, 0.0, 0.0)),
            color=tints[0] if sole else self._new("std_msgs/msg/ColorRGBA", r=1.0, g=1.0, b=1.0, a=1.0),
            lifetime=self._new("builtin_interfaces/msg/Duration", sec=0, nanosec=0),
            points=[points[i] for i in corners], colors=[] if sole else [tints[i] for i in corners],
            texture_resource="", uv_coordinates=[], text="", mesh_resource="", mesh_use_embedded_materials=False,
            texture=self._new("sensor_msgs/msg/CompressedImage", header=self._header(0, ""), format="", data=nothing),
            mesh_file=self._new("visualization_msgs/msg/MeshFile", filename="", data=nothing),
        )  # fmt: skip

    def _points(self, x: Float, at: int) -> Any:
        """Return a point cloud of x (n, 3) [m] in the frame CLOTH, as float32."""
        kind = self.store.types[field := "sensor_msgs/msg/PointField"].FLOAT32
        fields = [self._new(field, name=axis, offset=4 * k, datatype=kind, count=1) for k, axis in enumerate("xyz")]
        data = np.ascontiguousarray(x, np.float32).reshape(-1).view(np.uint8)
        return self._new(
            POINTS, header=self._header(at, CLOTH), height=1, width=len(x), fields=fields, is_bigendian=False,
            point_step=12, row_step=12 * len(x), data=data, is_dense=True,
        )  # fmt: skip
