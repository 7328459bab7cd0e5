"""What the decoder and its pipeline processes say to each other: JSON, one object a line.

Knows the vocabulary and its checks; refuses to know how lines travel.
"""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, fields
from typing import Any

from sfglab.errors import SfglabError

RELAY = "relay"
"""Codec hint of a pipeline that passes messages on as they are."""


class ProtocolError(SfglabError, ValueError):
    """A line that is not in the vocabulary."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Open:
    """To a worker: run this pipeline."""

    source_topic: str  #: The remote topic to subscribe to.
    source_type: str  #: Its ROS type.
    codec: str  #: Hint for the codec where the type alone does not tell ("h264", "rvl", ...); may be empty.
    local_topic: str  #: The local topic to publish on.
    replay_topic: str  #: Where the stream's last group of pictures may be replayed; empty: nowhere.
    transports: tuple[str, ...]  #: By which transports the local topic is wanted.


@dataclass(frozen=True, slots=True, kw_only=True)
class Serve:
    """To a worker: the local topic is now wanted by these transports."""

    transports: tuple[str, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class Close:
    """To a worker: end the pipeline and wait for the next one."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Ready:
    """From a worker: imports are done, the middleware is up, a pipeline can be opened."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Opened:
    """From a worker: the pipeline runs."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Closed:
    """From a worker: the pipeline has ended and holds nothing any more."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Failed:
    """From a worker: the pipeline could not be opened or broke."""

    why: str  #: One sentence.


@dataclass(frozen=True, slots=True, kw_only=True)
class Statistics:
    """From a worker, now and then: what the pipeline has done since it was opened."""

    received: int  #: Messages from the remote stream.
    replayed: int  #: Messages from its replay.
    published: int  #: Images handed to local subscribers.
    broken: int  #: Messages that could not be decoded.
    last_error: str  #: The latest decoding error; empty without one.


Line = Open | Serve | Close | Ready | Opened | Closed | Failed | Statistics
_KINDS: dict[str, type[Any]] = {
    cls.__name__.lower(): cls for cls in (Open, Serve, Close, Ready, Opened, Closed, Failed, Statistics)
}


def encode_line(line: Line) -> bytes:
    """Return one line, newline included."""
    return json.dumps({"kind": type(line).__name__.lower(), **asdict(line)}).encode() + b"\n"


def decode_line(raw: bytes) -> Line:
    """Read one line.

    Raises:
        ProtocolError: It is not JSON, of an unknown kind, or its keys are not those of its kind.
    """
    try:
        values = json.loads(raw)
        kind = _KINDS[values.pop("kind")]
        needed = {f.name for f in fields(kind)}
    except (ValueError, KeyError, AttributeError, TypeError) as error:
        raise ProtocolError(f"pipeline protocol: given {raw[:80]!r}, which is no line of it") from error
    if set(values) != needed:
        raise ProtocolError(
            f"pipeline protocol: {kind.__name__}: given {sorted(values)}, needed {sorted(needed)}"
        )
    if "transports" in values:
        values["transports"] = tuple(values["transports"])
    return kind(**values)  # type: ignore[no-any-return]  # one of the classes above
