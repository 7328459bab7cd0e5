"""The range of DDS domains, and the one that a process takes part in when none is named."""

from __future__ import annotations

import os

from sfglab.errors import InvalidValueError

# RTPS 2.5, clause 9.6.2.3: ports are 7400 + 250 * domain id (+ offsets), so 233 leaves the 16-bit range.
MAX_DOMAIN = 232  #: The last domain whose ports exist.
VARIABLE = "ROS_DOMAIN_ID"


def usual_domain_id() -> int:
    """Return the domain of a process that names none: ROS_DOMAIN_ID, or an `InvalidValueError`; else 0."""
    given = os.environ.get(VARIABLE) or "0"
    if not (given.isascii() and given.isdecimal() and len(given) < 9 and int(given) <= MAX_DOMAIN):
        raise InvalidValueError(VARIABLE, given, f"whole numbers from 0 to {MAX_DOMAIN}")
    return int(given)
