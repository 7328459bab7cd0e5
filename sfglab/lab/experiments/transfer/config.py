"""What the transfer experiment runs: paper C, section 4, Fig. 5, at three lengths."""

from __future__ import annotations

from dataclasses import dataclass

from sfglab.lab.experiments.profiles import of_profile
from sfglab.soc.memory import MESSAGE_BYTES, SUBSCRIBERS

__all__ = ["Config"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Config:
    """The whole run.

    Attributes:
        profile: Name of the profile it came from.
        refits: Starts from which the model is fitted anew.
        rtl_subscribers: Numbers of hardware subscribers for which the hardware is simulated.
        rtl_check_bytes: Bytes that the hardware moves where a law of cycles is checked; a multiple of 64.
        areas: Whether the gateway is synthesised.
        live_bytes: Message sizes across processes; multiples of 8.
        live_subscribers: Numbers of subscribing processes on the hardware's side.
        live_rounds: How often every cell is repeated; 0: nothing is live.
        most_subscribers: Largest number of hardware subscribers in the break-even chart.
        sizes: How many sizes the topics of Fig. 8 take, from 100 B to 10 MB.
        small_graphs: Random graphs on which node mapping is compared with brute force.
        small_nodes: Their largest number of nodes.
        large_graphs: Random graphs on which node mapping is timed.
        large_nodes: Their number of nodes.
        seed: Seed of everything that is drawn.
    """

    profile: str
    refits: int
    rtl_subscribers: tuple[int, ...] = SUBSCRIBERS
    rtl_check_bytes: int
    areas: bool = True
    live_bytes: tuple[int, ...] = MESSAGE_BYTES
    live_subscribers: tuple[int, ...] = SUBSCRIBERS
    live_rounds: int
    most_subscribers: int = 16
    sizes: int = 26
    small_graphs: int
    small_nodes: int
    large_graphs: int
    large_nodes: int
    seed: int = 0

    @classmethod
    def of_profile(cls, profile: str, *, seed: int = 0) -> Config:
        """Return the configuration of a profile.

        Args:
            profile: ``smoke`` (seconds), ``quick`` (minutes) or ``paper`` (500 repetitions, laws at 1 MB).
            seed: Seed of everything that is drawn.

        Raises:
            ConfigError: There is no such profile.
        """
        return of_profile(_PROFILES, profile, seed=seed)


_PROFILES = {
    "smoke": Config(
        profile="smoke",
        refits=2,
        rtl_subscribers=(2,),
        rtl_check_bytes=4096,
        areas=False,
        live_bytes=(10_000,),
        live_subscribers=(2,),
        live_rounds=3,
        most_subscribers=8,
        sizes=6,
        small_graphs=2,
        small_nodes=5,
        large_graphs=1,
        large_nodes=12,
    ),
    "quick": Config(
        profile="quick",
        refits=20,
        rtl_check_bytes=100_032,
        live_rounds=40,
        small_graphs=12,
        small_nodes=8,
        large_graphs=4,
        large_nodes=50,
    ),
    "paper": Config(
        profile="paper",
        refits=30,
        rtl_check_bytes=1_000_000,
        live_rounds=500,
        small_graphs=40,
        small_nodes=8,
        large_graphs=10,
        large_nodes=50,
    ),
}
