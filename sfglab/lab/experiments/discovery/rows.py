"""The rows that the discovery experiment writes into its log, one class a table."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["FleetRow", "HostRow", "SimulatedRow"]


@dataclass(frozen=True, slots=True, kw_only=True)
class FleetRow:
    """One fleet, started once.

    Attributes:
        cell: Counter from 0.
        mode: ``standard`` or ``routed``.
        agents: Size of the fleet.
        talkers: Publishing nodes of each agent.
        listeners: Subscribing nodes of each agent.
        repeat: Which repetition.
        resolved_s: From the start signal until the last agent had resolved all its peers, seconds.
        censored: Whether it was given up instead; `resolved_s` is then how long it was waited for.
        signal_s: How long it took to give the start signal to all processes, seconds.
        window_s: From the start signal to the last reading of the meters, seconds.
        nodes_cpu_s: CPU time of the ROS 2 nodes in that window, seconds.
        components_cpu_s: CPU time of routers, status providers and discoverers, seconds.
        machine_percent: Everything else that ran on the machine, per cent of one core.
        steal_percent: Time the hypervisor took, per cent of one core.
    """

    cell: int
    mode: str
    agents: int
    talkers: int
    listeners: int
    repeat: int
    resolved_s: float
    censored: bool
    signal_s: float
    window_s: float
    nodes_cpu_s: float
    components_cpu_s: float
    machine_percent: float
    steal_percent: float


@dataclass(frozen=True, slots=True, kw_only=True)
class HostRow:
    """One agent of a fleet.

    Attributes:
        cell: The cell.
        host: Which agent, from 0.
        resolved_s: From the start signal until it had resolved all its peers, seconds.
        censored: Whether it was given up instead; `resolved_s` is then how long it was waited for.
        own_bytes: Received at its interface until then.
        fleet_bytes: Received at its interface until the whole fleet had resolved.
        own_packets: Frames received until then.
    """

    cell: int
    host: int
    resolved_s: float
    censored: bool
    own_bytes: float
    fleet_bytes: float
    own_packets: float


@dataclass(frozen=True, slots=True, kw_only=True)
class SimulatedRow:
    """One agent of a simulated fleet.

    Attributes:
        mode: ``standard`` or ``routed``.
        agents: Size of the fleet.
        talkers: Publishing nodes of each agent.
        listeners: Subscribing nodes of each agent.
        seed: Seed of the run.
        host: Which agent, from 0.
        resolved_s: From the start until it had resolved all its peers, simulated seconds.
        rx_bytes: Received at its interface until then.
        censored: Whether it was given up instead.
    """

    mode: str
    agents: int
    talkers: int
    listeners: int
    seed: int
    host: int
    resolved_s: float
    rx_bytes: float
    censored: bool
