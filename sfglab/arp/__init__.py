"""Paper B: aggregated robot processing, its caches (2.2, 2.3) and its balanced QoS (2.4).

Robots sense and act, a station localises and plans; what crosses between them is held back when it repeats.
"""

from __future__ import annotations

from sfglab.arp.balancing import (
    Balance,
    BalanceInput,
    InfeasibleBalanceError,
    average_topics,
    balance,
    balance_closed_form,
)
from sfglab.arp.cache import CacheControl, CacheCounters, Decision, LocalCache
from sfglab.arp.equality import Equality, exactly_equal, nearly_equal

__all__ = [
    "Balance",
    "BalanceInput",
    "CacheControl",
    "CacheCounters",
    "Decision",
    "Equality",
    "InfeasibleBalanceError",
    "LocalCache",
    "average_topics",
    "balance",
    "balance_closed_form",
    "exactly_equal",
    "nearly_equal",
]
