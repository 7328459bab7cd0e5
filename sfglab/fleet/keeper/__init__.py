"""First frame at once: the sender keeps the last group of pictures and gives it to whoever joins late.

Paper A, section 5.4: a subscriber waits for the next key frame, half a second on average with the groups of
Table 2. Bottom up: `cache` (the packets since the last key frame), `session` (the table of one replay's
states), `topics` (where a stream's replay is), `node` (the keeper), `app` (the keeper as a process). The other
end is `sfglab.fleet.decoder.joiner`.
"""

from __future__ import annotations

from sfglab.fleet.keeper.cache import GopCache, Limits
from sfglab.fleet.keeper.topics import (
    FFMPEG_PACKET,
    FLAG_DISCARD,
    FLAG_KEY,
    REPLAY_DEPTH,
    REPLAY_QOS,
    replay_topic,
)

__all__ = [
    "FFMPEG_PACKET",
    "FLAG_DISCARD",
    "FLAG_KEY",
    "REPLAY_DEPTH",
    "REPLAY_QOS",
    "GopCache",
    "Limits",
    "replay_topic",
]
