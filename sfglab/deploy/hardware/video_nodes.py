"""Codecs behind V4L2's device nodes, as on a Raspberry Pi."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from sfglab.deploy.hardware.files import plain
from sfglab.deploy.hardware.machine import CodecRole, Evidence, ExpectedCodec, Source
from sfglab.fleet.fleet_file import Accelerator

if TYPE_CHECKING:
    from sfglab.deploy.hardware.files import MachineFiles


_H264 = {
    "bcm2835-codec-decode": CodecRole.DECODER,
    "bcm2835-codec-encode": CodecRole.ENCODER,
}
"""H.264 codecs of Raspberry Pi 4 and before (Raspberry Pi's kernel, bcm2835-v4l2-codec.c)."""

_HEVC = frozenset({"rpivid", "rpi-hevc-dec"})
"""The HEVC decoder of Raspberry Pi 4 and 5, by its old and its new driver."""

_CODEC = re.compile(r"(?:.*[-_ ])?(?:enc|encode|encoder|dec|decode|decoder)", re.IGNORECASE)


def find_v4l2(files: MachineFiles) -> Evidence:
    """Return whether a V4L2 device node is a codec, by its driver's name in /sys/class/video4linux.

    A codec of any format makes the machine one for V4L2, because base images differ by driver, not by format;
    the reason says what it does for H.264, which may be nothing: a Raspberry Pi 5 has an HEVC decoder and
    neither encodes nor decodes H.264 in hardware (Raspberry Pi 5 Product Brief: '4Kp60 HEVC decoder'). Cameras
    and image processors, as pispbe and bcm2835-isp, are no codecs. Which formats an unknown codec has could
    only be asked by opening it.
    """
    codecs = [
        (path, name) for path, name in _nodes(files) if name in _H264 or name in _HEVC or _CODEC.fullmatch(name)
    ]
    sources = tuple(Source(path=path, says=name) for path, name in codecs)
    if not codecs:
        cameras = len(_nodes(files))
        seen = f"{cameras} video device(s), but none is a codec" if cameras else "no video device"
        return Evidence(accelerator=Accelerator.V4L2, found=False, reason=seen)
    roles = [_H264[name] for _, name in codecs if name in _H264]
    return Evidence(
        accelerator=Accelerator.V4L2,
        found=True,
        reason=_what(frozenset(roles), frozenset(name for _, name in codecs)),
        sources=sources,
        devices=tuple(path for path, _ in codecs),
        codecs=tuple(
            ExpectedCodec(name="h264_v4l2m2m", role=role, why="stateful V4L2 codec of the board")
            for role in CodecRole
            if role in roles
        ),
    )


def _nodes(files: MachineFiles) -> list[tuple[str, str]]:
    """Return device nodes and their drivers' names; a node without a name is of no use."""
    nodes = []
    for path in files.paths("/dev", r"video[0-9]+"):
        name = plain(files.text(f"/sys/class/video4linux/{path.removeprefix('/dev/')}/name") or "")
        if name:
            nodes.append((path, name))
    return nodes


def _what(roles: frozenset[CodecRole], names: frozenset[str]) -> str:
    if roles:
        does = " and ".join(role.value for role in CodecRole if role in roles)
        return f"H.264 {does} in hardware"
    if names <= _HEVC:
        return "an HEVC decoder only: H.264 is encoded and decoded by the processor"
    return f"codecs whose formats are not known without opening them ({', '.join(sorted(names))})"
