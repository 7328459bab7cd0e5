"""DDS domains: their range, and the default domain of a process."""

from __future__ import annotations

import os

from sfglab.errors import InvalidValueError

# RTPS 2.5, clause 9.6.2.3: ports are 7400 + 250 * domain id (+ offsets), so 233 leaves the 16-bit range.
MAX_DOMAIN = 232  #: Highest domain with valid ports.
VARIABLE = "ROS_DOMAIN_ID"


def usual_domain_id() -> int:
    """Return the default DDS domain: the value of ROS_DOMAIN_ID, or 0 if it is not set.

    Raises:
        InvalidValueError: The value is no domain, 0 to 232.
    """
    given = os.environ.get(VARIABLE) or "0"
    if not (given.isascii() and given.isdecimal() and len(given) < 9 and int(given) <= MAX_DOMAIN):
        raise InvalidValueError(VARIABLE, given, f"a whole number from 0 to {MAX_DOMAIN}")
    return int(given)
