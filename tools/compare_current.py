"""Write the results of the current version as files: one side of `tools/compare.py`.

It does what `compare_baseline` does, and overrides what was renamed or moved since.
"""

from __future__ import annotations

import sys

from compare_baseline import COMMANDS, PLACES, SEEDED, main

COMMANDS |= {
    "map-size.txt": ["map", "data/graphs/driving.yaml", "--gateway-rule", "size"],
    "qos-paper.txt": ["qos", "data/qos/paper_b.yaml", "--method", "paper"],
}
SEEDED["driving"] |= {"model"}
SEEDED["mocap"] = {"trees"}
SEEDED["planning"] = {"facts"}
PLACES["design"] = "sfglab.lab.experiments.decode_once.results"

if __name__ == "__main__":
    main(sys.argv[1:])
