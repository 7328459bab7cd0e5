"""Compare what an older version computes with what this one does.

    python tools/compare.py build/old                    # a tree of the older version
    python tools/compare.py build/old --only rows:naming --only rules

Each version runs a driver of its own (`compare_baseline.py`, `compare_current.py`) from its own
tree, with the environment in its ``.venv`` if it has one. Both read the committed logs of the older
tree. The tool compares claims and figures from these logs, the rows of all seeded parts in the
profile smoke, and artefacts: messages, codecs, files that commands write, transition tables.

Tables are compared in the columns, and JSON in the keys, that both versions have. Columns and keys
that only one version has are listed. The exit status is 0 if every difference has a reason in
`REASONS`. This command makes a tree of the version that `compare_baseline.py` can drive:

    git worktree add build/old 671791e4
"""

from __future__ import annotations

import argparse
import csv
import fnmatch
import json
import math
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

TOOLS = Path(__file__).resolve().parent
ROOT = TOOLS.parent
TOLERANCE = 1e-12  #: Relative; re-associating one sum changes the last bit.
REASONS: dict[str, str] = {
    "claims/B-COOP by *": "plain words; contacts and intervals by conditions came, contrasts and live "
    "values went; Newcombe's interval where a bootstrap had no variance",
    "claims/B-LAT by transmission *": "plain words; causes are in the table of causes",
    "claims/B-LOSS by *": "plain words; the air without losses is no detail",
    "claims/B-TAB2 by transmission details *": "plain words",
    "claims/C-DRIVE* by driving details *": "only other sources of the same number are kept",
    "claims/C-DRIVE* by driving reason": "in plain words",
    "figures/driving_*": "drawn from tidy tables; note and sidecar come from the run",
    "rows/cooperation.course.csv *": "columns that nothing reads went",
    "rows/transmission.cell.csv *": "columns that nothing reads went",
    "rows/driving.chain.csv order": "no result reads it",
    "rows/driving.chain.csv place": "no result reads it",
    "rows/driving.lap.csv *": "the town has no buildings, and fields went that no result reads",
    "rows/driving.node.csv in_hardware": "no result reads it",
    "rows/driving.track.csv *": "the town has no buildings, and fields went that no result reads",
    "rows/driving.transfer.csv*": "topic A is in the table chain, and the second set of constants went",
    "figures/discovery_*": "drawn from tidy tables in plain words; queries and published descriptions apart",
    "figures/heartbeats*": "the table of checks has the periods",
    "claims/A-DISC-* by discovery *": "details in plain words; simulated fleets answer no claim",
    "claims/A-DFA by lifecycle details*": "in plain words",
    "claims/A-HEARTBEAT by lifecycle details*": "in plain words",
    "commands/map*.txt": "a column is narrower by two blanks",
    "figures/cooperation*": "drawn from tidy tables; three figures went; sidecar from the run",
    "figures/transmission_*": "drawn from tidy tables; two figures went; sidecar from the run",
    "figures/phases*": "squares where the configuration asks for them; phases_cells went; sidecar from the run",
    "rows/discovery.simulated.csv *": "replies reach all clients of a service; fleets with published "
    "descriptions came; computed fleets and bytes went",
    "claims/B-LAT by phases *": "the count of conditions without a median went",
    "claims/B-LOSS by phases details*": "the count of conditions without a median went",
    "rows/phases.*": "no conditions are added near borders; a column that nothing reads went",
    "claims/B-* by balancing details*": "bytes and frames came; in plain words",
    "figures/balancing_*": "drawn from tidy tables; balancing_stale went; sidecar from the run",
    "rows/balancing.*": "columns that nothing reads went; an example has fewer fields; that the compiled "
    "cache passes the same readings is a test",
    "claims/A-DEPLOY by deployment *": "facts that other programs confirm; all other checks are tests",
    "figures/deployment_*": "facts are a table in the notebook; sidecar from the run",
    "claims/A-FIRST by latency *": "numbers of a thousand and more have no exponent",
    "figures/performance.*": "no claim names the message budget: the notebook was removed",
    "figures/reliability.*": "no claim names the soak test: the notebook was removed",
    "rows/mocap.edge.csv contradicting": "static transforms and stamps that are published twice are counted",
    "claims/A-VICON by mocap details*": "one live run; checks of faults and flips are tests; plain words",
    "figures/mocap_*": "drawn from tidy tables; mocap_offset went; sidecar from the run",
    "rows/mocap.check.csv*": "checks of faults, of mappings' texts and of counts are tests",
    "rows/mocap.confusion.csv": "flips went; occlusions and losses are counted in a test",
    "rows/mocap.offset.csv": "the offset is configuration",
    "claims/A-PLAN by planning details*": "seven facts; the other checks are tests",
    "figures/planning_*": "in plain words; re-timing went; sidecar from the run",
    "rows/planning.*": "seven facts in one table; the other checks are tests",
    "claims/C-FSM by gateways details*": "mutated tables and the core without its claim are tests",
    "claims/C-MAP by gateways details*": "details in plain words",
    "figures/gateway_core*": "title and note in plain words; sidecar from the run",
    "figures/graph_mapping*": "title in plain words; sidecar from the run",
    "rows/gateways.*": "columns that nothing reads went; an example is the first case",
    "claims/C-[HS]W[HS]W by transfer details*": "fits and checks of cycles are tests; plain words",
    "claims/C-[HS]W[HS]W by transfer fitted*": "in plain words, with the paper's own form of a number",
    "figures/transfer*": "labels in plain words; three figures went; sidecar from the run",
    "figures/node_mapping*": "node mapping is a test",
    "rows/transfer.*": "tables that served checks went; the bars of a second fit are a test",
    "claims/A-VIZ by visualisation *": "the share of six facts, in plain words",
    "figures/visualisation_latency*": "the stopped sink is a test; sidecar from the run",
    "figures/visualisation_points*": "the reference is called a closed form",
    "claims/* count": "the number of facts behind a share is a field of its own",
    "claims/A-* by decode_once *": "details in plain words; the lack of fit went",
    "claims/A-G2G* by latency details*": "details that a table has went",
    "claims/A-FQN by naming details*": "the table of checks has them",
    "rows/naming.check.csv*": "a check that a test repeats went",
    "rows/routing.policy.csv*": "two checks that tests repeat went",
    "claims/A-RVL by depth_codecs details*": "details that a table has went",
    "claims/A-NET-RULES by routing details*": "latencies went; plain words",
    "claims/A-FIRST-OURS by latency details*": "paths are named as in the text",
    "figures/decode_once_*": "drawn from tidy tables in plain words; sidecar from the run",
    "figures/depth_codecs*": "drawn from tidy tables in plain words; sidecar from the run",
    "figures/latency*": "drawn from tidy tables in plain words; sidecar from the run",
    "figures/naming_schema*": "in plain words; sidecar from the run",
    "figures/routing_border*": "in plain words; latencies went; sidecar from the run",
    "figures/ros2_features*": "the table of features is in the book",
    "rules/discovery *": "states and inputs have other names; the life cycle is published or queried",
    "rows/discovery.simulated.csv": "replies reach all clients of a service; computed fleets went",
    "rows/visualisation.check.csv *": "facts have names of their own; the group went",
    "rows/visualisation.cloud.csv *": "missing points and other colours make the error infinite",
    "commands/fleet-lint.*": "warnings on style went; the topic of descriptions came",
    "dds-router.yaml": "the topic of descriptions came; fewer remarks",
    "ros-*.yaml": "the example's fleet file has fewer fields",
    "folders/*/image/fleet.yaml": "the example's fleet file has fewer fields",
    "messages/sfglab_rows.msg.*": "rows have only the columns that a result reads",
    "commands/qos-paper.txt": "channel utilisation is named; of VOLATILE Fast DDS, loss is an upper bound",
    "commands/qos-*.txt": "VOLATILE writers of Fast DDS: one depth, and loss as an upper bound",
    "folders/*/systemd/*": "the service starts the release that a link names",
    "folders/*/hooks/30-service.sh": "the file .env stays outside of the release",
    "folders/interfaces/sfglab_interfaces/msg/StreamInfo.msg": "a comment named the codec med",
    "folders/interfaces/sfglab_interfaces/msg/MocapObject.msg": "a comment: one latency is not measured",
    "folders/interfaces/sfglab_interfaces/action/FollowTrajectory.action": "a comment named goals that overtake",
}
"""Reasons for differences, by a pattern of their names."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Compare both versions and print every difference; return the exit status."""
    given = _parser().parse_args(arguments)
    with tempfile.TemporaryDirectory(prefix="sfglab-compare-") as folder:
        sides = [Path(folder, "old"), Path(folder, "new")]
        logs = given.old / "data" / "reference"
        runs = [
            _start(given.baseline, given.old, sides[0], logs, given.only),
            _start(given.driver, given.new, sides[1], logs, given.only),
        ]
        statuses = [run.wait() for run in runs]
        if any(statuses):
            print(f"compare: a driver ended with status {max(statuses)}", file=sys.stderr)
            return 2
        unexplained = _report(list(differences(*sides)))
        compared = sum(1 for file in sides[0].rglob("*") if file.is_file())
    print(f"{compared} files compared, {unexplained} differences without a reason")
    return 1 if unexplained else 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("old", type=Path, help="tree of the older version")
    parser.add_argument("--new", type=Path, default=ROOT, help="tree of the newer version")
    parser.add_argument(
        "--driver", default="compare_current.py", help="driver of the newer version"
    )
    parser.add_argument("--baseline", default="compare_baseline.py", help="driver of the older one")
    parser.add_argument("--only", action="append", default=[], help="section (repeatable)")
    return parser


def _start(
    driver: str, tree: Path, folder: Path, logs: Path, only: Sequence[str]
) -> subprocess.Popen[bytes]:
    tree = tree.resolve()
    python = tree / ".venv" / "bin" / "python"
    argv = [str(python) if python.is_file() else sys.executable, str(TOOLS / driver)]
    path = os.pathsep.join([str(tree), str(tree / "tests")])
    environment = os.environ | {"PYTHONPATH": path, "SFGLAB_ROOT": str(tree)}
    argv += [str(folder), str(logs.resolve()), *only]
    return subprocess.Popen(argv, cwd=tree, env=environment, stdout=subprocess.DEVNULL)


def _report(found: list[tuple[str, str]]) -> int:
    unexplained = 0
    for name, what in found:
        reason = next((r for p, r in REASONS.items() if fnmatch.fnmatch(name, p)), "")
        unexplained += not reason
        print(f"{name}: {what}" + (f" (reason: {reason})" if reason else ""))
    return unexplained


def differences(old: Path, new: Path) -> Iterator[tuple[str, str]]:
    """Yield the name and a description of everything that differs between two folders."""
    names = [
        {file.relative_to(side).as_posix() for file in side.rglob("*") if file.is_file()}
        for side in (old, new)
    ]
    for name in sorted(names[0] ^ names[1]):
        yield name, f"only in the {'old' if name in names[0] else 'new'} version"
    for name in sorted(names[0] & names[1]):
        if name.endswith(".csv"):
            yield from _different_rows(name, old / name, new / name)
        elif name.endswith(".json") and not name.startswith(("folders/", "commands/")):
            both = [json.loads((side / name).read_text("utf-8")) for side in (old, new)]
            yield from _different_values(name.removesuffix(".json"), *both)
        elif (old / name).read_bytes() != (new / name).read_bytes():
            yield name, "other bytes"


def _different_rows(name: str, old: Path, new: Path) -> Iterator[tuple[str, str]]:
    tables = []
    for file in (old, new):
        with file.open(encoding="utf-8", newline="") as opened:
            tables.append(list(csv.DictReader(opened)))
    columns = [set(table[0]) if table else set() for table in tables]
    for column in sorted(columns[0] ^ columns[1]):
        version = "old" if column in columns[0] else "new"
        yield f"{name} {column}", f"column only in the {version} version"
    if len(tables[0]) != len(tables[1]):
        yield name, f"{len(tables[0])} and {len(tables[1])} rows"
        return
    for column in sorted(columns[0] & columns[1]):
        pairs = [(a[column], b[column]) for a, b in zip(*tables, strict=True)]
        wrong = [pair for pair in pairs if pair[0] != pair[1]]
        if wrong:
            yield f"{name} {column}", f"{len(wrong)} of {len(pairs)} rows, first {wrong[0]}"


def _different_values(name: str, old: Any, new: Any) -> Iterator[tuple[str, str]]:
    if isinstance(old, dict) and isinstance(new, dict):
        for key in sorted(old.keys() ^ new.keys()):
            yield f"{name} {key}", f"only in the {'old' if key in old else 'new'} version"
        for key in sorted(old.keys() & new.keys()):
            yield from _different_values(f"{name} {key}", old[key], new[key])
    elif isinstance(old, list) and isinstance(new, list) and len(old) == len(new):
        for place, both in enumerate(zip(old, new, strict=True)):
            yield from _different_values(f"{name} {place}", *both)
    elif not _equal(old, new):
        yield name, f"{old!r} and {new!r}"


def _equal(old: Any, new: Any) -> bool:
    numbers = all(isinstance(value, int | float) for value in (old, new))
    if not numbers or isinstance(old, bool) or isinstance(new, bool):
        return bool(old == new)
    if math.isnan(old) or math.isnan(new):
        return math.isnan(old) and math.isnan(new)
    return math.isclose(old, new, rel_tol=TOLERANCE, abs_tol=0.0)


if __name__ == "__main__":
    sys.exit(main())
