"""What a machine has beside its processor, from its files alone, and which codecs that lets one expect.

Paper A, section 4.4, chooses an image's base by the host's accelerator; this is what finds it.
"""

from __future__ import annotations

from sfglab.deploy.hardware.codecs import CodecFound, codecs_found, expected_codecs
from sfglab.deploy.hardware.detection import PREFERENCE, detect
from sfglab.deploy.hardware.examples import EXAMPLES, ExampleMachine, write_example
from sfglab.deploy.hardware.machine import (
    CodecRole,
    DeviceGroup,
    Evidence,
    ExpectedCodec,
    Machine,
    Preference,
    Source,
)
from sfglab.deploy.hardware.report import render_machine

__all__ = [
    "EXAMPLES",
    "PREFERENCE",
    "CodecFound",
    "CodecRole",
    "DeviceGroup",
    "Evidence",
    "ExampleMachine",
    "ExpectedCodec",
    "Machine",
    "Preference",
    "Source",
    "codecs_found",
    "detect",
    "expected_codecs",
    "render_machine",
    "write_example",
]
