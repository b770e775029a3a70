"""The recorder service: writes every recorded message of a run and acknowledges each frame."""

from __future__ import annotations

import functools
import json
import time
from typing import Any

from nuno.bus.encodings import BadMessage
from nuno.bus.messages import ALL, Inbox, Message, Query
from nuno.exports.meshes import Show
from nuno.exports.viewer_messages import PAUSE, ViewerMessages
from nuno.process import SIGNALS
from nuno.recording.reader import END, Recording, copy_until, open_recording
from nuno.recording.writer import RecordingWriter, check_payload, topic_of
from nuno.runtime.service import LOOK_SECONDS, Context, each_message
from nuno.scene.provenance import CHANGE_RESULTS, assets, describe_run
from nuno_schemas.errors import BadInput, RunFailed
from nuno_schemas.messages import ACK, FRAMES, REPORT, Header

DRAIN_SECONDS = 10.0
"""Time without a message after which missing ones are given up at the end [s]. Writing queued messages to a slow disk
may take longer, and they are still written."""


def main(context: Context) -> None:
    """Record until the query to finish.

    That query has `expected` (messages sent per topic), `report` and `state`; the reply has the
    file, its counts and missing messages. If the supervisor goes, or this service is interrupted, the
    file is closed as incomplete and kept. Raises BadInput where the file cannot be created, RunFailed
    when the disk is full.
    """
    path = context.options.record
    if path is None:
        raise BadInput("the recorder needs a file", field="--record", remedy="name one: --record FILE")
    inbox = Inbox(context.bus, [ALL])
    folder, metadata = context.options.folder, describe_run(context.loaded, context.bus.run)
    if context.options.resume is not None:
        with open_recording(folder / context.options.resume) as previous:
            if others := _other_versions(context, previous, metadata["versions"] | metadata["plugins"]):
                metadata["resumed"] = others
    shown = _viewer_messages(context)
    writer = RecordingWriter(folder / path, metadata, assets(context.loaded), shown)
    if context.options.resume is not None:
        try:
            with open_recording(folder / context.options.resume) as previous:
                copy_until(previous, writer)
        except BaseException:
            writer.discard()  # the resumed recording is still whole
            raise
    shown.pause = PAUSE
    recorder = Recorder(context, inbox, writer)
    try:
        query = each_message(context, inbox, recorder.handle, between=lambda: min(LOOK_SECONDS, writer.flush_due()))
        answer = {} if query.json().get("discard") else recorder.finish(query)
    except (RunFailed, KeyboardInterrupt):
        if not writer.closed:
            recorder.close("failed", {})
        raise
    except BaseException:
        writer.abort()
        raise
    finally:
        inbox.close()
    if not writer.closed:
        writer.discard()
    query.answer_json(answer)


def _viewer_messages(context: Context) -> ViewerMessages:
    """Return the maker of the messages for viewers; prints are left out, since a colour for each vertex takes much."""
    scene, painter = context.loaded.scene, None
    if scene.dye is not None:
        from nuno.dye.painter import DyeSketch

        painter = DyeSketch(scene.dye)
    show = Show(lambda path: None, painter, "plain")
    return ViewerMessages(show, scene.duration * scene.frame_rate, functools.partial(context.event, "warning"))


def _other_versions(context: Context, previous: Recording, here: dict[str, str]) -> dict[str, str]:
    """Return the packages' and plugins' versions of the frames before a resumed run, by name, where they differ from
    `here`; warn of each.
    """
    recorded = previous.metadata.get("versions", {}) | previous.metadata.get("plugins", {})
    t, others = previous.common_checkpoint().t, dict(previous.metadata.get("resumed", {}))
    for name in here:
        if (was := recorded.get(name)) not in (None, here[name]) and (name in CHANGE_RESULTS or "/" in name):
            others[name] = f"{was} before {t:g} s"
            text = f"{name} was {was} before {t:g} s, and is {here[name]}: equal bits are promised for equal versions"
            context.event("warning", text, t=t)
    return others


class Recorder:
    """Writes the messages of an inbox to a recording."""

    def __init__(self, context: Context, inbox: Inbox, writer: RecordingWriter) -> None:
        self._context, self._inbox, self._writer = context, inbox, writer
        self._digests: dict[str, str] = {}
        """Digest of the last frame, by topic."""
        self._warned: set[str] = set()
        """Topics with a warning of missing messages."""
        self._copied = dict(writer.counts)
        """Numbers of messages copied from the resumed recording, by topic."""

    def handle(self, message: Message) -> None:
        """Write one message; acknowledge a frame once the writer has it."""
        header = message.header
        topic = topic_of(message.topic)
        if topic is None:
            return
        try:
            check_payload(topic, message.payload)
            self._writer.write(message.topic, header, message.payload)
        except BadMessage:
            self._inbox.refuse(message)
            return
        if message.skipped and message.topic not in self._warned:
            self._warned.add(message.topic)
            text = f"{message.skipped} of {message.topic} never came: the recording is incomplete"
            self._context.event("warning", text, header.frame, header.t)
        if message.topic in FRAMES:
            self._digests[message.topic] = header.digest
            self._context.acknowledge(header.frame, header.t)
        self._writer.show(message.topic, message.payload)  # the run goes on meanwhile

    def finish(self, query: Query) -> dict[str, Any]:
        """Wait for all sent messages, add the report, close the file; return the reply."""
        request = query.json()
        sent = request.get("expected", {})
        expected = {str(topic): int(number) for topic, number in sent.items() if topic_of(topic) is not None}
        self._drain(expected)
        report = request.get("report")
        if report is not None:
            header = Header(run=self._context.bus.run, service=self._context.bus.service, seq=0, frame=-1, t=0.0)
            self._writer.write(REPORT.name, header, json.dumps(report).encode())
        return self.close(str(request.get("state", "done")), expected)

    def close(self, state: str, expected: dict[str, int]) -> dict[str, Any]:
        """Write the closing metadata and finish the file.

        Only a run that ended in order and lost nothing is complete: without the expected counts,
        the sent messages are unknown.
        """
        counts, missing = self._writer.counts, self._missing(expected)
        end = {
            "state": state,
            "digest": next((self._digests[topic] for topic in FRAMES if self._digests.get(topic)), ""),
            "counts": json.dumps(counts),
            "missing": json.dumps(missing),
            "refused": json.dumps(self._refused()),
            "complete": "true" if expected and not missing and state not in ("failed", *SIGNALS) else "false",
        }
        path = self._writer.finish({END: end}, end["complete"] == "true" and state in ("done", "stopped"))
        size = path.stat().st_size
        return {
            "file": str((self._context.options.record or path).with_name(path.name)),
            "messages": sum(counts.values()),
            "counts": {topic: self._written(topic) for topic in counts},
            "payload_bytes": self._writer.bytes,
            "bytes": size,
            "seconds": self._writer.seconds,
            "missing": missing,
            "refused": self._refused(),
            "complete": end["complete"] == "true",
        }

    def _drain(self, expected: dict[str, int]) -> None:
        end, counts = time.monotonic() + DRAIN_SECONDS, self._inbox.counts
        # Messages are accounted for that arrived, or are lost since later ones arrived.
        while time.monotonic() < end and any(
            counts.received[topic] + counts.missing[topic] < number for topic, number in expected.items()
        ):
            item = self._inbox.get(timeout=0.1)
            if isinstance(item, Message):
                self.handle(item)
                end = time.monotonic() + DRAIN_SECONDS

    def _written(self, topic: str) -> int:
        """Return the number of this run's messages in the file."""
        return self._writer.counts[topic] - self._copied.get(topic, 0)

    def _refused(self) -> dict[str, int]:
        """Return refused messages by topic; the stepping service checks acknowledgements itself."""
        counts = self._inbox.counts.refused
        return {topic: number for topic, number in counts.items() if number and not topic.startswith(f"{ACK.name}/")}

    def _missing(self, expected: dict[str, int]) -> dict[str, int]:
        """Return messages missing in the file by topic: lost on the way, or refused by the writer."""
        topics = {*expected, *(topic for topic in self._inbox.counts.missing if topic_of(topic) is not None)}
        lost = {
            topic: max(expected.get(topic, 0) - self._written(topic), self._inbox.counts.missing[topic])
            for topic in sorted(topics)
        }
        return {topic: number for topic, number in lost.items() if number > 0}
