"""Configuration and tables of the experiment on decoding once per device.

A cell is one number of subscribers in one mode. The modes of one number of subscribers are measured directly after
each other, so that a machine that slows down affects all modes.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from sfglab.errors import InvalidValueError
from sfglab.lab.bench import TableRow
from sfglab.lab.experiment import Actor, Experiment, Link, Profiled

H264 = "h264"
HANDED_ON = ("dds", "proxy")
"""Modes in which one decoder passes pictures on: over DDS as in the paper, and over shared memory."""
_ALL = tuple(range(1, 11))
_FEW = (1, 4, 7, 10)


def _former_stage(codec: str, source: str) -> dict[str, Any]:
    """Return a stage in the removed field ``stages``."""
    counts = {key: [*_ALL] for key in ("counts", "dds_counts", "network_counts")}
    return {"codec": codec, "source": source, **counts, "repeats": 2}


@dataclass(frozen=True, slots=True, kw_only=True)
class Config(Profiled):
    """Source, numbers of subscribers and times of the run."""

    source: str = "photos"  #: Source of the frames, as `open_source` takes it.
    counts: tuple[int, ...] = _ALL  #: Numbers of local subscribers.
    #: Those of them with which the decoder also passes pictures on over DDS.
    dds_counts: tuple[int, ...] = _FEW
    #: Numbers of subscribers that receive without decoding, to separate c_net from c_dec.
    network_counts: tuple[int, ...] = _FEW
    #: Number of repetitions of every cell that decodes. Two give the pure error.
    repeats: int = 2
    samples: int = 3  #: Number of meter readings in a cell.
    period_s: float = 0.7  #: Time between readings, s.
    #: Time between the last subscriber's first frame and the first reading of a cell, s.
    settle_s: float = 0.5
    raw_s: float = 2.2  #: Duration for which the stream's messages are recorded, s.
    encoder: str = "auto"  #: H.264 encoder by FFmpeg's name, or ``auto``.
    #: Use of multicast by DDS between hosts: ``spdp`` (for discovery only, as Cyclone DDS does on
    #: Wi-Fi, the paper's network) or ``default`` (for data as well, on a wired link).
    multicast: Literal["spdp", "default"] = "spdp"
    seed: int = 0  #: Seed of the frames' path and of the order of cells.


exp = Experiment(
    "decode_once",
    Config,
    where="A 4.3, 5.2",
    smoke={
        # With two subscribers and two samples the slope is lost in noise on a busy machine.
        "counts": (1, 4),
        "dds_counts": (1, 4),
        "network_counts": (4,),
        "repeats": 1,
        "samples": 4,
        "period_s": 0.3,
        "settle_s": 0.1,
        "raw_s": 1.2,
    },
    paper={
        "dds_counts": _ALL,
        "network_counts": _ALL,
        "samples": 60,
        "period_s": 1.0,
        "settle_s": 2.0,
        "raw_s": 10.0,
    },
    hosts=("edge", "consumer"),
    actors=(
        Actor("camera", "edge", "encodes and publishes"),
        Actor("decoder", "consumer", "decodes once, while there is a subscriber"),
        Actor("subscriber", "consumer", "reads every pixel", count="1 to 10"),
    ),
    links=(
        Link(
            "camera",
            "subscriber",
            "standard, receive only: compressed frames, to each",
            boundary="network",
        ),
        Link("camera", "decoder", "decode once: compressed frames, once", boundary="network"),
        Link("decoder", "subscriber", "frames over DDS"),
        Link("decoder", "subscriber", "or frames", over="shared memory"),
    ),
    removed={
        "most": {"paper": 10},
        "ros2": {"paper": [1, 3]},
        "raw_bytes": {"paper": 20_000_000},
        "stages": {"paper": [_former_stage(H264, "photos"), _former_stage("rvl", "stereo")]},
    },
)


@exp.table("cell")
class CellRow(TableRow):
    """One cell: a number of subscribers in one mode, measured once."""

    cell: int  #: Number of the cell, from 0.
    mode: str  #: ``standard``, ``dds``, ``proxy`` or ``network``.
    subscribers: int  #: Number of local subscribers.
    repeat: int  #: Number of the repetition.


@exp.table("load")
class LoadRow(TableRow):
    """One meter reading in a cell."""

    cell: int  #: Number of the cell.
    label: str  #: Host: ``consumer`` or ``edge``.
    cpu_percent: float  #: CPU load of the host's processes, per cent of one core.
    rx_mbit_s: float  #: Data rate received at the host's interface, Mbit/s.


@exp.table("view")
class ViewRow(TableRow):
    """Frames of one subscriber in a cell. The capture stamp identifies a frame."""

    cell: int  #: Number of the cell.
    viewer: int  #: Number of the subscriber.
    frames: int  #: Number of images, or of messages in mode ``network``.
    unreadable: int  #: Number of images with a stamp that the camera did not send.
    missed: int  #: Number of skipped frames.
    disordered: int  #: Number of images that were not newer than the image before.
    broken: int  #: Number of messages that could not be decoded.
    #: Median time from the capture stamp to the arrival of the image, ms; NaN in mode ``network``.
    age_ms: float


def check_counts(config: Config) -> None:
    """Check that lines and the cost model can be fitted to the numbers of subscribers.

    Raises:
        InvalidValueError: One of the fields with numbers of subscribers has too few numbers.
    """
    if len(set(config.counts)) < 2:
        raise InvalidValueError("counts", config.counts, "two numbers or more")
    if len(set(config.counts).intersection(config.dds_counts)) < 2:
        raise InvalidValueError("dds_counts", config.dds_counts, "two of counts or more")
    if not config.network_counts:
        raise InvalidValueError("network_counts", config.network_counts, "at least one")


def groups_of(config: Config) -> list[tuple[CellRow, ...]]:
    """Return the cells in groups, in the order of measurement; the cells of a group are compared with each other.

    A group has the modes with one number of subscribers in one repetition. The order of the numbers of subscribers is
    random in each repetition, and so is the order of the modes in each group.
    """
    rng = np.random.default_rng(config.seed)
    numbers = itertools.count()
    groups = []
    for repeat in range(config.repeats):
        modes_of = [(count, decoding_modes(config, count)) for count in config.counts]
        if repeat == 0:
            modes_of += [(count, ["network"]) for count in config.network_counts]
        rng.shuffle(modes_of)
        for count, modes in modes_of:
            rng.shuffle(modes)
            group = [
                CellRow(cell=next(numbers), mode=mode, subscribers=count, repeat=repeat)
                for mode in modes
            ]
            groups.append(tuple(group))
    return groups


def decoding_modes(config: Config, count: int) -> list[str]:
    """Return the modes with decoded images that are measured with a number of subscribers."""
    return ["standard", "proxy", "dds"] if count in config.dds_counts else ["standard", "proxy"]
