"""Motion capture and the tree of frames: paper A, section 4.5, Eq. 4 and Fig. 6.

Exact: the trees of Fig. 6 and of random robots, faults of cameras. Live: robot, bridge and listener on
hosts of their own, the direct receiver beside them.
"""

from sfglab.lab.experiments.mocap.analysis import checks, errors
from sfglab.lab.experiments.mocap.experiment import exp

__all__ = ["checks", "errors", "exp"]
