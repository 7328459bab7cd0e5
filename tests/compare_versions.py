"""Two versions of sfglab compared: verdicts, figures and, where a run is deterministic, logs.

``python tests/compare_versions.py OLD_TREE NEW_TREE`` lets both versions compute ledger and figures from the
reference logs of the new tree, each in a process of its own, and compares what they say: verdicts and texts
exactly, numbers to 1e-9 of their size, SVG by bytes, PNG by pixels. With ``--deterministic`` both run what does
not depend on the machine's speed, and their logs are compared: metadata, schemas, rows, messages. Committed
figures are not looked at: they may come from another machine. The exit status is 1 if anything differs.
"""

import argparse
import asyncio
import json
import math
import os
import re
import shutil
import subprocess
import sys
from dataclasses import dataclass, field
from functools import cache, partial
from itertools import takewhile
from pathlib import Path
from tempfile import TemporaryDirectory

RELATIVE = 1e-9
SHOWN, LONGEST = 6, 120  # differences of one comparison, and characters of each value
# Digests and tags of a version's own files, its commit and that commit's time.
OWN = re.compile(
    r"\b(?:\d{4}(?:-\d\d){2}T(?:\d\d:){2}\d\d\+00:00|[0-9a-f]{64}|[0-9a-f]{40}(?:-dirty)?|\d+\.\d+\.\d+-[0-9a-f]{12})\b"
)


@dataclass(frozen=True)
class Run:
    """How an experiment is run so that two runs give the same log, and what of it depends on the machine."""

    changes: dict[str, object] = field(default_factory=dict)  # of the smoke profile
    options: dict[str, object] = field(default_factory=dict)  # of the run
    only: frozenset[str] = frozenset()  # topics that are compared; none: all
    but: frozenset[str] = frozenset()  # topics that are not
    columns: frozenset[str] = frozenset()  # of tables, that are not compared
    live: bool = False  # whether a live part, which may fail, comes after what is compared


TIMED = (
    "camera_s compensation_s gaussian_blur_s lane_planner_s polyfit_s red_light_detection_s "
    "green_light_detection_s visual_odometry_s lane_control_s"
)
TOGETHER = {"separate": False}
MOCAP = frozenset({"/table/check", "/table/confusion", "/table/offset"})
RUNS = {
    "naming": Run(),
    "depth_codecs": Run(columns=frozenset({"encode_ms", "decode_ms"})),
    "balancing": Run(),
    "transmission": Run(changes={"live_s": 0.0}),
    "cooperation": Run(changes={"live_s": 0.0}),
    "gateways": Run(),
    "transfer": Run(changes={"live_rounds": 0}, columns=frozenset({"seconds"})),
    "discovery": Run(options=TOGETHER),
    "driving": Run(but=frozenset({"/table/chain"}), columns=frozenset(TIMED.split())),
    "planning": Run(),
    # Files hold the version's own wheel, which gives the images their tag.
    "deployment": Run(columns=frozenset({"size_bytes", "sha256", "digest"})),
    "routing": Run(options=TOGETHER, only=frozenset({"/table/policy"}), live=True),
    "mocap": Run(options=TOGETHER, only=MOCAP, live=True),
}


# What runs in a tree


def show(log: Path, folder: Path) -> None:
    """Write the ledger's lines and the figures of one experiment, whose name is the reference log's."""
    from sfglab.lab.ledger import compute_ledger, redraw_figures
    from sfglab.lab.paths import Project

    project = Project(root=folder)
    project.reference_logs.mkdir(parents=True)
    shutil.copy("data/claims.yaml", project.claims)  # those of the tree in which this runs
    shutil.copy(log, project.reference_logs)
    entries = [entry.as_json() for entry in compute_ledger(project) if entry.claim.experiment == log.stem]
    (folder / "claims.json").write_text(json.dumps(entries))
    redraw_figures(project, [log.stem])


def execute(what: Path, folder: Path) -> None:
    """Run an experiment into a log."""
    from sfglab.lab.bench import Options
    from sfglab.lab.experiments import experiment

    how, path = RUNS[what.name], folder / "run.mcap"
    asyncio.run(experiment(what.name).run("smoke", path=path, options=Options(**how.options), **how.changes))


def failure(tree: Path, *what: object) -> str:
    """Let one version do something, in a process of its own; return what it wrote if it failed."""
    env = {**os.environ, "PYTHONPATH": str(tree), "MPLBACKEND": "agg"}
    env.pop("SFGLAB_ROOT", None)
    command = [sys.executable, "-P", str(Path(__file__).resolve()), "--inside", *map(str, what)]
    done = subprocess.run(command, cwd=tree, env=env, text=True, capture_output=True, check=False)
    return f"exit status {done.returncode}: {done.stderr.strip()[-1500:]}" if done.returncode else ""


# What is compared


def leaves(value, place):
    """Yield each place of a JSON value that holds no others, with what stands there."""
    if value and isinstance(value, dict | list):
        for key, part in value.items() if isinstance(value, dict) else enumerate(value):
            yield from leaves(part, f"{place}.{key}")
    else:
        yield place, value


def differences(old, new, place: str):
    """Yield where two JSON values differ: numbers by more than `RELATIVE` of their size."""
    before, after = dict(leaves(old, place)), dict(leaves(new, place))
    for at in before | after:
        if at not in before or at not in after:
            yield f"{at}: only in the {'old' if at in before else 'new'} version"
        elif not _same(before[at], after[at]):
            texts = repr(before[at]), repr(after[at])
            equal = sum(1 for _ in takewhile(lambda pair: pair[0] == pair[1], zip(*texts, strict=False)))
            start = max(0, equal - 20)
            yield f"{at}: {' against '.join(text[start : start + LONGEST] for text in texts)}"


def _same(old, new) -> bool:
    if isinstance(old, float) and isinstance(new, float):
        return math.isclose(old, new, rel_tol=RELATIVE) or (math.isnan(old) and math.isnan(new))
    return type(old) is type(new) and old == new


def read_figure(path: Path, *, pictures: bool):
    """Return a twin's content; of a picture what two versions must have in common."""
    if path.suffix == ".json":
        return json.loads(path.read_text())
    if not pictures:
        return None
    import cv2

    pixels = cv2.imread(str(path), cv2.IMREAD_UNCHANGED) if path.suffix == ".png" else None
    return path.read_text() if pixels is None else [pixels.shape, pixels.tobytes()]


def read_shown(folder: Path, *, pictures: bool) -> dict[str, object]:
    """Return what a version said and drew."""
    drawn = {path.name: read_figure(path, pictures=pictures) for path in (folder / "figures").glob("*")}
    return {"claims": json.loads((folder / "claims.json").read_text())} | drawn


def read_log(folder: Path, how: Run) -> dict[str, object]:
    """Return of a log what two runs must have in common, without sfglab's own reader of files."""
    from mcap.reader import make_reader

    from sfglab.messages import decoder_from_definition

    decoder = cache(decoder_from_definition)
    found: dict[str, object] = {}
    with (folder / "run.mcap").open("rb") as file:
        reader = make_reader(file)
        summary = reader.get_summary()
        for channel in summary.channels.values():
            schema = summary.schemas[channel.schema_id]
            definition = re.sub(r"\s*#.*", "", schema.data.decode())  # a comment may say it better
            found[f"schema {channel.topic}"] = [schema.name, definition]
            found[channel.topic] = []
        found |= {f"metadata {record.name}": record.metadata for record in reader.iter_metadata()}
        for attachment in reader.iter_attachments():
            found[f"attachment {attachment.name}"] = attachment.data.decode(errors="backslashreplace")
        for schema, channel, message in reader.iter_messages():
            kept = [message.log_time, message.data.hex()]
            if channel.topic.startswith("/table/"):
                row = vars(decoder(schema.name, schema.data.decode())(message.data))
                kept = {k: v for k, v in row.items() if k not in {*how.columns, "__msgtype__"}}
            found[channel.topic].append(kept)
    # Which of the two versions writes a completion is no difference of a run.
    left_out = {"metadata run", "metadata completion", *how.but, *(f"schema {topic}" for topic in how.but)}
    compared = {
        k: v
        for k, v in found.items()
        if k not in left_out and (not how.only or k in how.only or k.startswith(("metadata", "schema")))
    }
    return json.loads(OWN.sub("(own)", json.dumps(compared, default=lambda value: value.tolist())))


def compare(trees: dict[str, Path], kind: str, what, read, *, may_fail: bool = False) -> bool:
    """Let both versions do the same, print a line and what differs, and return whether anything did."""
    name = Path(what).stem
    with TemporaryDirectory(prefix="sfglab-compare-") as folder:
        folders = {version: Path(folder, version) for version in trees}
        for path in folders.values():
            path.mkdir()
        failed = {version: failure(tree, kind, what, folders[version]) for version, tree in trees.items()}
        found = [f"the {version} version failed: {text}" for version, text in failed.items() if text]
        if may_fail or not found:
            found = list(differences(*map(read, folders.values()), name))
    lines = [f"{name:14} {kind:8} {'DIFFERS' if found else 'same'}", *(f"    {line}" for line in found[:SHOWN])]
    if len(found) > SHOWN:
        lines.append(f"    and {len(found) - SHOWN} more")
    sys.stdout.write("\n".join(lines) + "\n")
    sys.stdout.flush()
    return bool(found)


def main() -> int:
    """Compare, and return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("old", type=Path)
    parser.add_argument("new", type=Path)
    parser.add_argument("--only", nargs="+", metavar="EXPERIMENT")
    parser.add_argument("--deterministic", action="store_true", help="run experiments and compare their logs")
    parser.add_argument("--skip-pictures", action="store_true", help="compare no SVG and PNG")
    parser.add_argument("--skip-shown", action="store_true", help="compare no ledger and figures")
    arguments = parser.parse_args()
    trees = {"old": arguments.old.resolve(), "new": arguments.new.resolve()}
    sys.path.insert(0, str(trees["new"]))  # its messages read the logs
    references = sorted((trees["new"] / "data" / "reference").glob("*.mcap"))
    wanted = set(arguments.only or (log.stem for log in references))
    read = partial(read_shown, pictures=not arguments.skip_pictures)
    differs = [
        compare(trees, "show", log, read)
        for log in references
        if log.stem in wanted and not arguments.skip_shown
    ]
    differs += [
        compare(trees, "execute", name, partial(read_log, how=how), may_fail=how.live)
        for name, how in RUNS.items()
        if name in wanted and arguments.deterministic
    ]
    return int(any(differs))


if __name__ == "__main__":
    if sys.argv[1:2] == ["--inside"]:
        _, kind, what, folder = sys.argv[1:]
        {"show": show, "execute": execute}[kind](Path(what), Path(folder))
    else:
        sys.exit(main())
