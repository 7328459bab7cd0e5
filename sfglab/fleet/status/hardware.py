"""What this machine brings: codecs that work in hardware, and the versions of what runs on it."""

from __future__ import annotations

from importlib.metadata import version

from sfglab import __version__

_LIBRARIES = ("cyclonedds", "av", "numpy")


def accelerators() -> tuple[str, ...]:
    """Return FFmpeg's names of the H.264 codecs that work in hardware here.

    Each candidate encodes or decodes a trial, which takes up to a second together.
    """
    from sfglab.codecs.probe import available_decoders, available_encoders

    probes = (*available_encoders(), *available_decoders())
    return tuple(dict.fromkeys(p.name for p in probes if p.hardware and p.works))


def software() -> tuple[str, ...]:
    """Return sfglab and the libraries that decide what it can do, each with its version."""
    return (f"sfglab {__version__}", *(f"{name} {version(name)}" for name in _LIBRARIES))
