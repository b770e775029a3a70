"""Turns a cut recording into a finished one that holds its whole chunks."""

from __future__ import annotations

import json
from pathlib import Path

from nuno.recording.mcap_file import CHUNK_BYTES, McapFile
from nuno.recording.reader import END, Recording
from nuno_schemas.errors import BadInput


def recover(path: Path | str, target: Path | None = None) -> Path:
    """Copy what can be read of `path` into an indexed file, by default beside it without ".part".

    The closing metadata says that it is incomplete. Returns the new file; the old one stays.
    Raises BadInput where `path` is no recording, is finished already, or `target` exists.
    """
    path = Path(path)
    if target is None:
        target = path.with_suffix("") if path.suffix == ".part" else path.with_name(path.stem + "-recovered.mcap")
    with Recording(path) as recording:
        if not recording.recovered:
            raise BadInput("the recording is finished: nothing to recover", str(path))
        if target.exists():
            raise BadInput("a file of that name exists", str(target), remedy="move it, or give another name")
        new = target.with_name(target.name + ".recovering")
        try:
            with new.open("wb") as stream:
                _copy(recording, McapFile(stream))
            new.replace(target)
        except BadInput:
            new.unlink(missing_ok=True)
            raise
        except OSError as error:
            new.unlink(missing_ok=True)
            raise BadInput(f"cannot write there: {error.strerror}", str(target)) from None
    return target


def _copy(recording: Recording, file: McapFile) -> None:
    for name, fields in recording.metadata.items():
        if name != END:
            file.add_metadata(name, fields)
    for name in recording.attachments:
        file.add_attachment(name, recording.attachment(name))
    layout = recording.layout
    channels = {}
    for channel in layout.channels.values():
        schema = layout.schemas.get(channel.schema_id)
        if schema is None:
            raise BadInput(f"the recording is damaged: {channel.topic} has no schema", str(recording.path))
        channels[channel.topic] = file.add_channel(
            channel.topic, channel.message_encoding, schema.name, schema.encoding, schema.data
        )
    for message in recording.messages():
        file.add_message(channels[message.topic], message.seq, message.log_time, message.publish_time, message.payload)
        if file.pending >= CHUNK_BYTES:
            file.flush()
    file.flush()
    end = {"state": "recovered", "complete": "false", "counts": json.dumps(recording.counts)}
    file.add_metadata(END, end | {"readable": str(layout.readable), "size": str(layout.size)})
    file.finish()
