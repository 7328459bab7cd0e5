"""Paper B: aggregated robot processing, its caches (2.2, 2.3) and its balanced QoS (2.4).

Robots sense and act, a station localises and plans; what crosses between them is held back when it repeats.
Beside the QoS problem that the paper prints stands our own (`programme.plan`), which sees the link.
"""

from __future__ import annotations

from sfglab.arp.balancing import (
    BalanceInput,
    InfeasibleBalanceError,
    average_topics,
    balance,
    balance_closed_form,
)
from sfglab.arp.cache import (
    CacheControl,
    Decision,
    LocalCache,
    exactly_equal,
    nearly_equal,
)
from sfglab.arp.plan import InfeasiblePlanError, Limits, Plan, assess, plan_as_printed
from sfglab.arp.programme import pareto_front, plan_file
from sfglab.arp.topics import Topic, TopicFile, load_topics, read_topics

__all__ = [
    "BalanceInput",
    "CacheControl",
    "Decision",
    "InfeasibleBalanceError",
    "InfeasiblePlanError",
    "Limits",
    "LocalCache",
    "Plan",
    "Topic",
    "TopicFile",
    "assess",
    "average_topics",
    "balance",
    "balance_closed_form",
    "exactly_equal",
    "load_topics",
    "nearly_equal",
    "pareto_front",
    "plan_as_printed",
    "plan_file",
    "read_topics",
]
