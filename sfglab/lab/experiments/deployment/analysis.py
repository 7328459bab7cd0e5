"""The claim A-DEPLOY: the share of checks that hold.

What could not be checked on the machine of the run does not count; it is told beside the share.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from sfglab.lab.checks import share_of_checks
from sfglab.lab.claims import Finding, How
from sfglab.lab.experiments.deployment.experiment import Config, exp

if TYPE_CHECKING:
    from sfglab.lab.runs import Run


@exp.claim("A-DEPLOY", how=lambda run: How.LIVE if run.config.containers else How.EXACT)
def share_that_holds(run: Run[Config]) -> Finding:
    """Return the share of checks that hold, in the group where it is lowest."""
    share, refused = share_of_checks(run["check"], "group"), run["refused"]["refused"]
    details = {
        **share.groups,
        "agents": ", ".join(dict.fromkeys(run["file"]["agent"])),
        "files of all machines": str(len(run["file"])),
        "broken fleets refused": f"{int(refused.sum())} of {len(refused)}",
        **{f"not checked here: {row.check}": str(row.why) for row in run["unchecked"].itertuples()},
    }
    return Finding(estimate=share.estimate, details=details, reason=share.reason)
