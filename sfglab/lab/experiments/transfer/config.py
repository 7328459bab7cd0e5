"""What the transfer experiment runs: paper C, section 4, Fig. 5, at three lengths."""

from __future__ import annotations

from dataclasses import dataclass

from sfglab.lab.experiments.profiles import of_profile
from sfglab.soc.memory import MESSAGE_BYTES, SUBSCRIBERS


@dataclass(frozen=True, slots=True, kw_only=True)
class Config:
    """The whole run."""

    profile: str  #: Name of the profile it came from.
    refits: int  #: Starts from which the model is fitted anew.
    #: Numbers of hardware subscribers for which the hardware is simulated.
    rtl_subscribers: tuple[int, ...] = SUBSCRIBERS
    rtl_check_bytes: int  #: Bytes that the hardware moves where a law of cycles is checked; a multiple of 64.
    areas: bool = True  #: Whether the gateway is synthesised.
    live_bytes: tuple[int, ...] = MESSAGE_BYTES  #: Message sizes across processes; multiples of 8.
    live_subscribers: tuple[int, ...] = SUBSCRIBERS  #: Numbers of subscribing processes on the hardware's side.
    live_rounds: int  #: How often every cell is repeated; 0: nothing is live.
    most_subscribers: int = 16  #: Largest number of hardware subscribers in the break-even chart.
    sizes: int = 26  #: How many sizes the topics of Fig. 8 take, from 100 B to 10 MB.
    small_graphs: int  #: Random graphs on which node mapping is compared with brute force.
    small_nodes: int  #: Their largest number of nodes.
    large_graphs: int  #: Random graphs on which node mapping is timed.
    large_nodes: int  #: Their number of nodes.
    seed: int = 0  #: Seed of everything that is drawn.

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
