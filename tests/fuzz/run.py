"""Fuzzing of every door, a process for each group of them: ``run.py [SECONDS SEED]`` prints counts as JSON."""

import json
import subprocess
import sys
from pathlib import Path

GROUPS = ("messages", "names", "pictures", "depth", "logs", "documents", "machines")


def through(group, seconds="0", seed="0"):
    """Return what came of a group's doors in its share of the time."""
    argv = [sys.executable, str(Path(__file__).with_name("group.py")), group]
    argv += [f"{float(seconds) / len(GROUPS)}", seed]
    return json.loads(subprocess.run(argv, stdout=subprocess.PIPE, text=True, check=True).stdout)


found = {group: through(group, *sys.argv[1:]) for group in GROUPS}
counts, faults = (
    {k: v for g in found.values() for k, v in g[what].items()} for what in ("counts", "faults")
)
peaks_mb = {group: round(one["peak_mb"]) for group, one in found.items()}
result = {"inputs": sum(counts.values()), "counts": counts, "faults": faults, "peak_mb": peaks_mb}
sys.stdout.write(json.dumps(result) + "\n")
