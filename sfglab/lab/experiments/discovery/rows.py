"""The rows that the discovery experiment writes into its log, one class a table."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class FleetRow:
    """One fleet, started once."""

    cell: int  #: Counter from 0.
    mode: str  #: ``standard`` or ``routed``.
    agents: int  #: Size of the fleet.
    talkers: int  #: Publishing nodes of each agent.
    listeners: int  #: Subscribing nodes of each agent.
    repeat: int  #: Which repetition.
    resolved_s: float  #: From the start signal until the last agent had resolved all its peers, seconds.
    censored: bool  #: Whether it was given up instead; `resolved_s` is then how long it was waited for.
    signal_s: float  #: How long it took to give the start signal to all processes, seconds.
    window_s: float  #: From the start signal to the last reading of the meters, seconds.
    nodes_cpu_s: float  #: CPU time of the ROS 2 nodes in that window, seconds.
    components_cpu_s: float  #: CPU time of routers, status providers and discoverers, seconds.
    machine_percent: float  #: Everything else that ran on the machine, per cent of one core.
    steal_percent: float  #: Time the hypervisor took, per cent of one core.


@dataclass(frozen=True, slots=True, kw_only=True)
class HostRow:
    """One agent of a fleet."""

    cell: int  #: The cell.
    host: int  #: Which agent, from 0.
    resolved_s: float  #: From the start signal until it had resolved all its peers, seconds.
    censored: bool  #: Whether it was given up instead; `resolved_s` is then how long it was waited for.
    own_bytes: float  #: Received at its interface until then.
    fleet_bytes: float  #: Received at its interface until the whole fleet had resolved.
    own_packets: float  #: Frames received until then.


@dataclass(frozen=True, slots=True, kw_only=True)
class SimulatedRow:
    """One agent of a simulated fleet."""

    mode: str  #: ``standard`` or ``routed``.
    agents: int  #: Size of the fleet.
    talkers: int  #: Publishing nodes of each agent.
    listeners: int  #: Subscribing nodes of each agent.
    seed: int  #: Seed of the run.
    host: int  #: Which agent, from 0.
    resolved_s: float  #: From the start until it had resolved all its peers, simulated seconds.
    rx_bytes: float  #: Received at its interface until then.
    censored: bool  #: Whether it was given up instead.
