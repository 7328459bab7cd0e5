"""Configuration and tables of the experiment on decoding once per device.

A cell is one number of subscribers in one mode. The modes of one number follow each other, so that a
machine that slows down slows all of them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from sfglab.errors import InvalidValueError
from sfglab.lab.bench import TableRow
from sfglab.lab.experiment import Actor, Experiment, Link, Profiled

H264 = "h264"
HANDED_ON = ("dds", "proxy")
"""Modes in which one decoder passes pictures on: over DDS as in the paper, and over shared memory."""
_ALL = tuple(range(1, 11))


@dataclass(frozen=True, slots=True, kw_only=True)
class Stage:
    """One camera stream, and how often it is measured with how many subscribers."""

    codec: str  #: Codec of the stream: ``h264``.
    #: Source of the frames, as `open_source` takes it; empty: the configuration's source.
    source: str = ""
    counts: tuple[int, ...]  #: Numbers of local subscribers.
    #: Those of them with which the decoder also passes pictures on over DDS.
    dds_counts: tuple[int, ...] = ()
    #: Numbers of subscribers that receive without decoding, to separate c_net from c_dec.
    network_counts: tuple[int, ...] = ()
    repeats: int = 1  #: Number of repetitions of every cell that decodes.


_COLOUR = Stage(
    codec=H264, counts=_ALL, dds_counts=(1, 4, 7, 10), network_counts=(1, 4, 7, 10), repeats=2
)
# Twice, so that repetitions give the pure error.
_WHOLE = Stage(codec=H264, counts=_ALL, dds_counts=_ALL, network_counts=_ALL, repeats=2)


@dataclass(frozen=True, slots=True, kw_only=True)
class Config(Profiled):
    """Streams, numbers of subscribers and times of the run."""

    source: str = "photos"  #: Source of the frames.
    stages: tuple[Stage, ...] = (_COLOUR,)  #: Streams, one after the other.
    samples: int = 3  #: Number of meter readings in a cell.
    period_s: float = 0.7  #: Time between readings, s.
    #: Time between the last subscriber's first frame and the first reading of a cell, s.
    settle_s: float = 0.5
    raw_s: float = 3.0  #: Duration for which a stream's messages are recorded, s.
    raw_bytes: int = 1_200_000  #: Largest amount that is recorded of one stream.
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
        "stages": (Stage(codec=H264, counts=(1, 4), dds_counts=(1, 4), network_counts=(4,)),),
        "samples": 4,
        "period_s": 0.3,
        "settle_s": 0.1,
        "raw_s": 1.2,
    },
    paper={
        "stages": (_WHOLE,),
        "samples": 60,
        "period_s": 1.0,
        "settle_s": 2.0,
        "raw_s": 10.0,
        "raw_bytes": 20_000_000,
    },
    hosts=("edge", "consumer"),
    actors=(
        Actor("camera", "edge", "encodes and publishes"),
        Actor("decoder", "consumer", "decodes once, while there is a subscriber"),
        Actor("subscriber", "consumer", "reads every pixel", count="1 to 10"),
    ),
    links=(
        Link("camera", "subscriber", "standard: compressed, to each", boundary="network"),
        Link("camera", "decoder", "decode once: compressed, once", boundary="network"),
        Link("decoder", "subscriber", "pictures over DDS"),
        Link("decoder", "subscriber", "or pictures", over="shared memory"),
    ),
    removed={
        "most": {"quick": 10, "paper": 10},
        "ros2": {"quick": [1, 3], "paper": [1, 3]},
    },
)


@exp.table("cell")
class CellRow(TableRow):
    """One cell: a number of subscribers in one mode, measured once."""

    cell: int  #: Counter from 0.
    codec: str  #: Codec of the stream.
    mode: str  #: ``standard``, ``dds``, ``proxy`` or ``network``.
    subscribers: int  #: Number of local subscribers.
    repeat: int  #: Number of the repetition.


@exp.table("load")
class LoadRow(TableRow):
    """One meter reading in a cell."""

    cell: int  #: Counter of the cell.
    label: str  #: ``consumer`` or ``edge``.
    cpu_percent: float  #: CPU of the host's processes, per cent of one core.
    rx_mbit_s: float  #: Received at the host's interface, Mbit/s.


@exp.table("view")
class ViewRow(TableRow):
    """Frames of one subscriber in a cell. The capture stamp identifies a frame."""

    cell: int  #: Counter of the cell.
    viewer: int  #: Number of the subscriber.
    frames: int  #: Pictures, or messages in mode ``network``.
    unreadable: int  #: Pictures with a stamp that the camera did not send.
    missed: int  #: Frames that were skipped.
    disordered: int  #: Pictures that were not newer than the one before.
    broken: int  #: Messages that could not be decoded.
    #: Median time from capture stamp to picture in hand, ms; NaN in mode ``network``.
    age_ms: float


def check_stages(config: Config) -> None:
    """Raise `InvalidValueError` if lines and the cost model cannot be fitted to the stages."""
    if not config.stages:
        raise InvalidValueError("stages", config.stages, "at least one")
    for number, stage in enumerate(config.stages):
        place = f"stages[{number}]"
        if stage.codec != H264:
            raise InvalidValueError(f"{place}.codec", stage.codec, H264)
        if len(set(stage.counts)) < 2:
            raise InvalidValueError(f"{place}.counts", stage.counts, "two numbers or more")
        if len(set(stage.counts).intersection(stage.dds_counts)) < 2:
            given = stage.dds_counts
            raise InvalidValueError(f"{place}.dds_counts", given, "two of counts or more")
        if not stage.network_counts:
            raise InvalidValueError(f"{place}.network_counts", stage.network_counts, "at least one")


@dataclass(frozen=True, slots=True, kw_only=True)
class Group:
    """Cells that are compared: the modes at one number of subscribers, in one repetition."""

    stage: Stage  #: Stream.
    subscribers: int  #: Number of subscribers.
    repeat: int  #: Number of the repetition.
    first: int  #: Counter of its first cell.
    modes: tuple[str, ...]  #: Modes in the order in which they are measured.

    def cells(self) -> list[CellRow]:
        """Return the cells in the order in which they are measured."""
        rows = []
        for place, mode in enumerate(self.modes):
            row = CellRow(
                cell=self.first + place,
                codec=self.stage.codec,
                mode=mode,
                subscribers=self.subscribers,
                repeat=self.repeat,
            )
            rows.append(row)
        return rows


def groups_of(config: Config) -> list[Group]:
    """Return all groups in the order in which they are measured.

    The numbers of subscribers are shuffled in each repetition, and the modes in each group.
    """
    rng = np.random.default_rng(config.seed)
    groups = []
    first = 0
    for stage in config.stages:
        for repeat in range(stage.repeats):
            modes_of = [(count, decoding_modes(stage, count)) for count in stage.counts]
            if repeat == 0:
                modes_of += [(count, ["network"]) for count in stage.network_counts]
            rng.shuffle(modes_of)
            for count, modes in modes_of:
                rng.shuffle(modes)
                group = Group(
                    stage=stage, subscribers=count, repeat=repeat, first=first, modes=tuple(modes)
                )
                groups.append(group)
                first += len(modes)
    return groups


def decoding_modes(stage: Stage, count: int) -> list[str]:
    """Return the modes with pictures that are measured with a number of subscribers."""
    modes = ["standard", "proxy"]
    if count in stage.dds_counts:
        modes.append("dds")
    return modes
