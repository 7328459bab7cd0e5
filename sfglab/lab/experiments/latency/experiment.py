"""Configuration and tables of the experiment on latency, and the order of its subscriptions.

A group is one repetition: one subscription on each path, all at the same phase of the group of pictures (GOP).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from sfglab.codecs import TABLE_2
from sfglab.lab.bench import TableRow
from sfglab.lab.experiment import Actor, Experiment, Link, Profiled

PATHS = ("standard", "decoder", "agent", "container", "on_demand")
"""Paths from the camera to the viewer, see `sfglab.lab.experiments.latency.live`."""
STEADY_PATHS = ("standard", "decoder", "agent", "container")
"""Paths whose steady state is measured. ``on_demand`` differs from ``container`` in its start only."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Config(Profiled):
    """Stream, number of subscriptions and times of the run."""

    #: Number of subscriptions on each path; on ``on_demand`` half as many.
    repeats: int = 20
    look_s: float = 0.5  #: Time that the viewer receives after its first picture, s.
    #: Number of pictures at the start of a subscription that do not count for the steady state.
    skipped: int = 3
    source: str = "photos"  #: Source of the frames, as `open_source` takes it.
    encoder: str = "auto"  #: H.264 encoder by FFmpeg's name, or ``auto``.
    #: Use of multicast by DDS between hosts: ``spdp`` (for discovery only, as Cyclone DDS does on
    #: Wi-Fi, the paper's network) or ``default`` (for data as well, on a wired link).
    multicast: Literal["spdp", "default"] = "spdp"
    seed: int = 0  #: Seed of the frames' path, of the phases and of the order of paths.


GOP_S = TABLE_2.gop / TABLE_2.fps
"""Time from key frame to key frame, s."""


exp = Experiment(
    "latency",
    Config,
    where="A 5.4",
    smoke={"repeats": 2, "look_s": 0.4},
    paper={"repeats": 120, "look_s": 1.0},
    hosts=("edge", "consumer"),
    actors=(
        Actor("camera", "edge", "encodes and publishes"),
        Actor("GOP cache", "edge", "stores the current group of pictures (sfglab)"),
        Actor("router", "edge", "forwards from the edge's domain to the global domain"),
        Actor("router 2", "consumer", "forwards from the global domain to the consumer's"),
        Actor("decoder", "consumer", "decodes on demand, except on standard"),
        Actor("viewer", "consumer", "subscribes on one path at a time"),
    ),
    links=(
        Link("camera", "viewer", "standard: compressed frames", boundary="network"),
        Link("camera", "GOP cache", "sfglab: compressed frames"),
        Link("camera", "router", "other paths: compressed frames"),
        Link("GOP cache", "router", "sfglab: replay"),
        Link("router", "router 2", "compressed frames, replay", boundary="network"),
        Link("router 2", "decoder", "compressed frames, replay"),
        Link("decoder", "viewer", "sfglab: decoded frames", over="shared memory"),
        Link("decoder", "viewer", "container, new process: decoded frames over DDS"),
    ),
    removed={
        "idle_s": {"paper": 30.0},
        "ros2": {"paper": 120},
        "link_mbit_s": {"paper": 50.0},
        "gop": {"paper": 30},
        "bitrate_mbit_s": {"paper": 4.0},
    },
)


@exp.table("look")
class LookRow(TableRow):
    """One subscription, from the order to subscribe to the order to stop."""

    look: int  #: Number of the subscription, from 0.
    repeat: int  #: Number of the repetition.
    path: str  #: One of `PATHS`.
    ordered_ns: int  #: Time at which the viewer received the order to subscribe (Unix time), ns.
    first_ns: int  #: Time at which the viewer received its first image (Unix time), ns.
    pictures: int  #: Number of images that the viewer received.
    unreadable: int  #: Number of images with a stamp that the camera did not send.
    missed: int  #: Number of skipped frames.
    disordered: int  #: Number of images that were not newer than the image before.
    broken: int  #: Number of messages that could not be decoded.
    replay_packets: int  #: Number of packets that the GOP caches sent for this subscription.


@exp.table("sight")
class SightRow(TableRow):
    """An image that the viewer received."""

    look: int  #: Number of the subscription.
    number: int  #: Number of the frame, as in `ShotRow`.
    seen_ns: int  #: Time at which the viewer received the image (Unix time), ns.


@exp.table("camera")
class ShotRow(TableRow):
    """A frame that the camera sent."""

    number: int  #: Number of the frame, plus `NUMBERS` for each repetition before.
    stamp_ns: int  #: Capture stamp (Unix time), ns.


NUMBERS = 10**6
"""Distance of the frame numbers of two repetitions in the tables.

A repetition may have another camera process, which counts from 0 again.
"""


@dataclass(frozen=True, slots=True, kw_only=True)
class Group:
    """The subscriptions of one repetition."""

    repeat: int  #: Number of the repetition.
    phase: float  #: Time of the orders to subscribe, as a share of the GOP.
    first: int  #: Number of the first subscription.
    paths: tuple[str, ...]  #: Paths, in the order of the subscriptions.


def groups_of(config: Config) -> list[Group]:
    """Return all repetitions, with random phases and random orders of the paths.

    The phases are a stratified sample: the GOP is divided into equal shares, and each share has one phase. The path
    ``on_demand``, whose subscriptions take longest, is part of every second repetition.
    """
    rng = np.random.default_rng(config.seed)
    places = rng.permutation(config.repeats)
    phases = (places + rng.uniform(size=config.repeats)) / config.repeats
    groups = []
    first = 0
    for repeat, phase in enumerate(phases):
        paths = rng.permutation(PATHS).tolist()
        if repeat % 2:
            paths.remove("on_demand")
        group = Group(repeat=repeat, phase=float(phase), first=first, paths=tuple(paths))
        groups.append(group)
        first += len(paths)
    return groups
