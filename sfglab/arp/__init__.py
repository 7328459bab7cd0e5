"""The package `arp` implements paper B: aggregated robot processing, its caches (2.2, 2.3) and its balanced QoS (2.4).

Robots sense and act; a station localises the robots and plans their motion. Caches suppress repeated values between
robots and station. The module `balancing` has the QoS problem that the paper publishes. The module `programme` has
our own QoS problem, which includes the link.
"""

from sfglab.arp.cache import CacheControl, LocalCache
from sfglab.arp.plan import Plan, plan_as_printed
from sfglab.arp.programme import pareto_front, plan_file
from sfglab.arp.topics import Topic, TopicFile, load_topics

__all__ = [
    "CacheControl",
    "LocalCache",
    "Plan",
    "Topic",
    "TopicFile",
    "load_topics",
    "pareto_front",
    "plan_as_printed",
    "plan_file",
]
