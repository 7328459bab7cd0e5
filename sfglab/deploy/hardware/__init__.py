"""What a machine has beside its processor, from its files alone, and which codecs that lets one expect.

Paper A, section 4.4, chooses an image's base by the host's accelerator; this is what finds it.
"""

from __future__ import annotations

from sfglab.deploy.hardware.detection import PREFERENCE, codecs_found, detect, expected_codecs
from sfglab.deploy.hardware.machine import (
    CodecFound,
    CodecRole,
    DeviceGroup,
    Evidence,
    ExpectedCodec,
    Machine,
    Preference,
    Source,
    render_machine,
)

__all__ = [
    "PREFERENCE",
    "CodecFound",
    "CodecRole",
    "DeviceGroup",
    "Evidence",
    "ExpectedCodec",
    "Machine",
    "Preference",
    "Source",
    "codecs_found",
    "detect",
    "expected_codecs",
    "render_machine",
]
