"""What the life-cycle experiment runs: paper A, section 4.2, at three lengths."""

from __future__ import annotations

from dataclasses import dataclass, field

from sfglab.fleet.discovery.registry import Timing
from sfglab.fleet.status.heartbeat import Schedule
from sfglab.lab.experiments.profiles import of_profile


@dataclass(frozen=True, slots=True, kw_only=True)
class Config:
    """The whole run."""

    profile: str  #: Name of the profile it came from.
    agents: int = 3  #: Status providers whose heartbeats are timed.
    #: Whether each of them is in a domain of its own behind a router, as the paper has it, so that what is
    #: timed has crossed its agent's border; else they are in the global domain themselves. The transitions are
    #: always run there, without routers in between.
    routed: bool = True
    #: Their schedule. The periods are the paper's in every profile but ``smoke``; the length of the start-up
    #: phase, which the paper does not state, is shortened.
    schedule: Schedule = field(default_factory=Schedule)
    steady_beats: int = 4  #: Heartbeats in the steady state that are waited for, per agent.
    tolerance: float = 0.05  #: How far a median period may be from the one announced or stated, relative to it.
    walker_period_s: float = 1.0  #: Period of the status process that is stopped and killed, seconds.
    #: The discoverer's waits while it is led through its transitions: short, so that all of them fit into
    #: seconds.
    timing: Timing = field(default_factory=lambda: _timing(1.0))
    query_timeout_s: float = 1.0  #: Its time limit for answers, seconds.
    #: How often the false agents try a transition that was missed, as on a machine that stalls.
    attempts: int = 3
    seed: int = 0  #: Kept for the record; nothing is drawn.

    @property
    def at_paper_periods(self) -> bool:
        """Whether heartbeats come at the paper's 1 s and 5 s."""
        paper = Schedule()
        mine = (self.schedule.startup_period_s, self.schedule.steady_period_s)
        return mine == (paper.startup_period_s, paper.steady_period_s)

    @classmethod
    def of_profile(cls, profile: str, *, seed: int = 0) -> Config:
        """Return the configuration of a profile.

        Args:
            profile: ``smoke`` (seconds, with heartbeats ten times as fast as the paper's), ``quick`` (under a
                minute) or ``paper`` (minutes).
            seed: Kept for the record.

        Raises:
            ConfigError: There is no such profile.
        """
        return of_profile(_PROFILES, profile, seed=seed)


def _timing(backoff_s: float) -> Timing:
    backoff_ns = round(backoff_s * 1e9)
    # A lost agent must be remembered for longer than its process takes to start again.
    return Timing(
        slack_ns=300_000_000,
        backoff_ns=backoff_ns,
        backoff_max_ns=2 * backoff_ns,
        forget_ns=3_000_000_000,
    )


_PROFILES = {
    "smoke": Config(
        profile="smoke",
        agents=2,
        routed=False,
        schedule=Schedule(startup_period_s=0.1, steady_period_s=0.5, startup_s=0.5),
        steady_beats=3,
        tolerance=0.2,
        walker_period_s=0.3,
        timing=_timing(0.6),
        query_timeout_s=0.6,
    ),
    "quick": Config(profile="quick", schedule=Schedule(startup_s=5.0), steady_beats=3, walker_period_s=0.5),
    "paper": Config(profile="paper", agents=6, steady_beats=24),
}
