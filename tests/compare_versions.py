"""Two versions of sfglab compared: verdicts, figures and, where a run is deterministic, logs.

``python tests/compare_versions.py OLD_TREE NEW_TREE`` lets both versions compute ledger and figures from the
reference logs of the new tree, each in a process of its own, and compares what they say: verdicts and texts
exactly, numbers to 1e-9 of their size, SVG by bytes, PNG by pixels. With ``--deterministic`` both run what does
not depend on the machine's speed, and their logs are compared: metadata, schemas, rows, messages. Committed
figures are not looked at: they may come from another machine. The exit status is 1 if anything differs.
"""

from __future__ import annotations

import argparse
import asyncio
import itertools
import json
import math
import os
import re
import shutil
import subprocess
import sys
import time
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

RELATIVE = 1e-9
SHOWN, LONGEST = 6, 400  # differences of one comparison, and characters of each
# Digests and tags of a version's own files, its commit and that commit's time.
OWN = re.compile(
    r"\b(?:\d{4}(?:-\d\d){2}T(?:\d\d:){2}\d\d\+00:00|[0-9a-f]{64}|[0-9a-f]{40}(?:-dirty)?|\d+\.\d+\.\d+-[0-9a-f]{12})\b"
)


@dataclass(frozen=True)
class Run:
    """How an experiment is run so that two runs give the same log, and what of it depends on the machine."""

    changes: dict[str, object] = field(default_factory=dict)  # of the smoke profile
    options: dict[str, object] = field(default_factory=dict)  # of the run
    only: frozenset[str] | None = None  # topics that are compared; None: all
    but: frozenset[str] = frozenset()  # topics that are not
    columns: frozenset[str] = frozenset()  # of tables, that are not compared
    # Whether a live part comes after what is compared: two would disturb each other, one may fail.
    live: bool = False


TIMED = (
    "camera_s compensation_s gaussian_blur_s lane_planner_s polyfit_s red_light_detection_s "
    "green_light_detection_s visual_odometry_s lane_control_s"
)
RUNS = {
    "naming": Run(),
    "depth_codecs": Run(columns=frozenset({"encode_ms", "decode_ms"})),
    "balancing": Run(),
    "transmission": Run(changes={"live_s": 0.0}),
    "cooperation": Run(changes={"live_s": 0.0}),
    "gateways": Run(),
    "transfer": Run(changes={"live_rounds": 0}, columns=frozenset({"seconds"})),
    "discovery": Run(options={"separate": False}),
    "driving": Run(but=frozenset({"/table/chain"}), columns=frozenset(TIMED.split())),
    "planning": Run(),
    # Files hold the version's own wheel, which gives the images their tag.
    "deployment": Run(columns=frozenset({"size_bytes", "sha256", "digest"})),
    "routing": Run(options={"separate": False}, only=frozenset({"/table/policy"}), live=True),
    "mocap": Run(
        options={"separate": False},
        only=frozenset({"/table/check", "/table/confusion", "/table/offset"}),
        live=True,
    ),
}


# What runs in a tree


def _project_with(tree: Path, log: Path, folder: Path):
    """Make a project that holds the tree's claims and one reference log, so that one experiment speaks."""
    from sfglab.lab.paths import Project

    project = Project(root=folder)
    project.reference_logs.mkdir(parents=True)
    shutil.copy(tree / "data" / "claims.yaml", project.claims)
    shutil.copy(log, project.reference_logs)
    return project


def show(tree: Path, log: Path, folder: Path) -> None:
    """Write the ledger's lines and the figures of one experiment, whose name is the log's."""
    from sfglab.lab.ledger import compute_ledger, redraw_figures

    name = log.stem
    project = _project_with(tree, log, folder)
    entries = [entry.as_json() for entry in compute_ledger(project) if entry.claim.experiment == name]
    (folder / "claims.json").write_text(json.dumps(entries))
    redraw_figures(project, [name])


def execute(name: str, path: Path) -> None:
    """Run an experiment into a log."""
    from sfglab.lab.bench import Options
    from sfglab.lab.experiments import experiment

    how = RUNS[name]
    asyncio.run(experiment(name).run("smoke", path=path, options=Options(**how.options), **how.changes))


def _start(tree: Path, *what: str) -> subprocess.Popen[str]:
    """Let one version do something, in a process of its own that imports sfglab from its tree."""
    env = {**os.environ, "PYTHONPATH": str(tree), "MPLBACKEND": "agg"}
    env.pop("SFGLAB_ROOT", None)
    command = [sys.executable, "-P", str(Path(__file__).resolve()), "--inside", *what]
    return subprocess.Popen(
        command, cwd=tree, env=env, text=True, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE
    )


# What is compared


def differences(old, new, place: str = ""):
    """Yield where two JSON values differ: numbers by more than `RELATIVE` of their size."""
    if isinstance(old, dict) and isinstance(new, dict):
        for key in sorted({*old, *new}):
            if key in old and key in new:
                yield from differences(old[key], new[key], f"{place}.{key}")
            else:
                yield f"{place}.{key}: only in the {'old' if key in old else 'new'} version"
    elif isinstance(old, list) and isinstance(new, list):
        if len(old) != len(new):
            yield f"{place}: {len(old)} against {len(new)} entries"
        for number, (a, b) in enumerate(zip(old, new, strict=False)):
            yield from differences(a, b, f"{place}[{number}]")
    elif isinstance(old, str) and isinstance(new, str) and old != new:
        equal = sum(
            1 for _ in itertools.takewhile(lambda pair: pair[0] == pair[1], zip(old, new, strict=False))
        )
        part = slice(max(0, equal - 20), equal + 80)
        yield f"{place}: {old[part]!r} against {new[part]!r}, from character {equal}"
    elif not _same(old, new):
        yield f"{place}: {old!r} against {new!r}"


def _same(old, new) -> bool:
    if isinstance(old, float) and isinstance(new, float):
        both_nan = math.isnan(old) and math.isnan(new)
        return both_nan or math.isclose(old, new, rel_tol=RELATIVE, abs_tol=0.0)
    return type(old) is type(new) and old == new


def _same_picture(old: Path, new: Path) -> bool:
    import cv2

    if old.suffix == ".png":
        a, b = (cv2.imread(str(path), cv2.IMREAD_UNCHANGED) for path in (old, new))
        return a.shape == b.shape and bool((a == b).all())
    return old.read_bytes() == new.read_bytes()


def compare_shown(old: Path, new: Path, *, pictures: bool):
    """Yield the differences between what two versions said and drew."""
    yield from differences(
        *(json.loads((folder / "claims.json").read_text()) for folder in (old, new)), "claims"
    )
    drawn = [{file.name for file in (folder / "figures").glob("*")} for folder in (old, new)]
    for name in sorted(drawn[0] ^ drawn[1]):
        yield f"{name}: only the {'old' if name in drawn[0] else 'new'} version draws it"
    for name in sorted(drawn[0] & drawn[1]):
        files = old / "figures" / name, new / "figures" / name
        if name.endswith(".json"):
            yield from differences(*(json.loads(file.read_text()) for file in files), name)
        elif pictures and not _same_picture(*files):
            yield f"{name}: the pictures differ"


def read_log(path: Path, how: Run) -> dict[str, object]:
    """Return of a log what two runs must have in common, without sfglab's own reader of files."""
    from mcap.reader import make_reader

    from sfglab.messages import decoder_from_definition

    found: dict[str, object] = {}
    with path.open("rb") as file:
        reader = make_reader(file)
        summary = reader.get_summary()
        for channel in summary.channels.values():
            schema = summary.schemas[channel.schema_id]
            definition = re.sub(r"\s*#.*", "", schema.data.decode())  # a comment may say it better
            found[f"schema {channel.topic}"] = [schema.name, definition]
            found[channel.topic] = []
        for record in reader.iter_metadata():
            found[f"metadata {record.name}"] = record.metadata
        for attachment in reader.iter_attachments():
            found[f"attachment {attachment.name}"] = attachment.data.decode(errors="backslashreplace")
        decoders = {}
        for schema, channel, message in reader.iter_messages():
            if not channel.topic.startswith("/table/"):
                found[channel.topic].append([message.log_time, message.data.hex()])
                continue
            if schema.id not in decoders:
                decoders[schema.id] = decoder_from_definition(schema.name, schema.data.decode())
            row = vars(decoders[schema.id](message.data))
            found[channel.topic].append(
                {k: v for k, v in row.items() if k not in {*how.columns, "__msgtype__"}}
            )
    found.pop("metadata run")
    found.pop("metadata completion", None)  # which of the two versions writes it is no difference of a run
    compared = {k: v for k, v in found.items() if k.split()[-1] not in how.but}
    if how.only is not None:
        compared = {k: v for k, v in compared.items() if k.startswith(("metadata", "schema")) or k in how.only}
    return json.loads(OWN.sub("(own)", json.dumps(compared, default=lambda value: value.tolist())))


def compare_logs(how: Run, old: Path, new: Path):
    """Yield the differences between the logs of two versions' runs."""
    return differences(*(read_log(folder / "run.mcap", how) for folder in (old, new)))


class Comparison:
    """Both trees, the folder for what they leave behind, and whether anything differed."""

    def __init__(self, old: Path, new: Path, folder: Path) -> None:
        self.trees = {"old": old, "new": new}
        self.folder = folder
        self.failed = False

    def both(self, kind: str, name: str, words) -> list[Path] | str:
        """Let both versions do the same, each with a folder of its own; text is an error."""
        folders = {version: self.folder / kind / name / version for version in self.trees}
        errors, started = {}, {}
        live = kind == "log" and RUNS[name].live
        for version, tree in self.trees.items():
            folders[version].mkdir(parents=True)
            started[version] = _start(tree, *words(tree, folders[version]))
            if live:
                errors[version] = started[version].communicate()[1]
        errors |= {v: process.communicate()[1] for v, process in started.items() if v not in errors}
        for version, process in started.items():
            if process.returncode and not live:
                return f"the {version} version failed: {errors[version].strip()[-1500:]}"
        return list(folders.values())

    def report(self, kind: str, name: str, words, compare) -> None:
        """Do, compare and print a line, and what differs."""
        before = time.perf_counter()
        ended = self.both(kind, name, words)
        found = [ended] if isinstance(ended, str) else list(compare(*ended))
        verdict = "DIFFERS" if found else "same"
        self.failed |= bool(found)
        lines = [f"{name:14} {kind:8} {verdict:8} {time.perf_counter() - before:5.1f} s"]
        lines += [f"    {line[:LONGEST]}" for line in found[:SHOWN]]
        if len(found) > SHOWN:
            lines.append(f"    and {len(found) - SHOWN} more")
        sys.stdout.write("\n".join(lines) + "\n")
        sys.stdout.flush()


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("old", type=Path)
    parser.add_argument("new", type=Path)
    parser.add_argument("--only", nargs="+", metavar="EXPERIMENT", default=())
    parser.add_argument("--deterministic", action="store_true", help="run experiments and compare their logs")
    parser.add_argument("--skip-pictures", action="store_true", help="compare no SVG and PNG")
    parser.add_argument("--skip-shown", action="store_true", help="compare no ledger and figures")
    return parser.parse_args()


def main() -> int:
    """Compare, and return the exit status."""
    arguments = _arguments()
    old, new = arguments.old.resolve(), arguments.new.resolve()
    sys.path.insert(0, str(new))  # its messages read the logs
    references = sorted((new / "data" / "reference").glob("*.mcap"))
    wanted = set(arguments.only) or {log.stem for log in references}
    with TemporaryDirectory(prefix="sfglab-compare-") as folder:
        comparison = Comparison(old, new, Path(folder))
        for log in () if arguments.skip_shown else references:
            if log.stem in wanted:
                show_words = partial(lambda log, tree, to: ("show", str(tree), str(log), str(to)), log)
                pictures = not arguments.skip_pictures
                comparison.report("shown", log.stem, show_words, partial(compare_shown, pictures=pictures))
        for name, how in RUNS.items() if arguments.deterministic else ():
            if name in wanted:
                run_words = partial(lambda name, _, to: ("execute", name, str(to / "run.mcap")), name)
                comparison.report("log", name, run_words, partial(compare_logs, how))
    return 1 if comparison.failed else 0


if __name__ == "__main__":
    if sys.argv[1:2] == ["--inside"]:
        action, *words = sys.argv[2:]
        if action == "show":
            show(*map(Path, words))
        else:
            execute(words[0], Path(words[1]))
    else:
        sys.exit(main())
