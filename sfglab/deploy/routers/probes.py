"""Names to ask two filters with, made from their patterns: where they differ, one of these shows it."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterable


PLAIN = ("rt/chatter", "rt/rosout", "rt/parameter_events", "rt/local/go2/x", "rt/tf2", "ros_discovery_info")
FILLINGS = ("", "a", "a/b", "aRequest", "aReply", "a/_action/status")


def probe_names(patterns: Iterable[str]) -> tuple[str, ...]:
    """Return DDS topic names inside, at the edge of and just outside of patterns, each once and sorted.

    Args:
        patterns: Names with ``*`` as wildcard.
    """
    names = set(PLAIN)
    for pattern in patterns:
        filled = {pattern.replace("*", filling) for filling in FILLINGS}
        names |= filled
        names |= {name[:-1] for name in filled} | {f"{name}_x" for name in filled}
        names |= {f"{name[:2]}/local{name[2:]}" for name in filled} | {
            name.replace("/", "ly/", 2) for name in filled
        }
    return tuple(sorted(name for name in names if name))
