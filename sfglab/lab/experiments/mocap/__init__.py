"""Motion capture and the tree of frames: paper A, section 4.5, Eq. 4 and Fig. 6.

Exact: both trees of Fig. 6, the one between, and the same for random robots; faults of cameras against the
known truth; and, beyond the paper, what an estimate of the offset is worth. Live: a robot with odometry of its
own, the bridge and a listener as processes on hosts of their own, the direct receiver beside them.
"""

from sfglab.lab.experiments.mocap.analysis import checks, errors, offsets
from sfglab.lab.experiments.mocap.experiment import exp

__all__ = ["checks", "errors", "exp", "offsets"]
