"""Logs as runs write them: made by tests, with only what matters given; smoke runs; and the committed ones."""

import asyncio
import shutil
from dataclasses import fields
from pathlib import Path
from typing import get_type_hints

from sfglab.fields import to_json
from sfglab.lab.claims import load_claims
from sfglab.record import LogWriter

DATA = Path(__file__).parents[1] / "data"
CLAIMS = {claim.id: claim for claim in load_claims(DATA / "claims.yaml")}


def reference(exp):
    """The committed run of an experiment."""
    return exp.load(DATA / "reference" / f"{exp.name}.mcap")


def share_findings(folder):
    """Let a checkout below `folder` keep what committed logs say where this checkout keeps it.

    To compute it takes half a minute. Its key has the inputs and the code, so no checkout gets wrong values.
    """
    kept = DATA.parent / "runs" / "cache"
    kept.mkdir(parents=True, exist_ok=True)
    (folder / "runs").mkdir(exist_ok=True)
    (folder / "runs" / "cache").symlink_to(kept)


def make_checkout(folder):
    """Make a checkout with notebooks, inputs, and the committed logs with what they say."""
    hidden, logs = shutil.ignore_patterns(".*"), shutil.ignore_patterns("reference")
    shutil.copytree(DATA.parent / "notebooks", folder / "notebooks", ignore=hidden)
    shutil.copytree(DATA, folder / "data", ignore=logs)
    (folder / "data" / "reference").symlink_to(DATA / "reference")
    share_findings(folder)


def ran(exp, path, **changes):
    """A smoke run of an experiment, with other values of its configuration."""
    return asyncio.run(exp.run("smoke", path=path, **changes))


def broken(checks):
    """The counterexample of each check of a table that does not hold."""
    wrong = checks[checks["held"] < checks["checked"]]
    return dict(zip(wrong["check"], wrong["example"], strict=True))


def made_row(exp, table, row):
    """A table's row; fields that are not given are zero, false or empty."""
    row_class = exp.tables[table]
    hints = get_type_hints(row_class)
    return row_class(**{**{f.name: hints[f.name]() for f in fields(row_class)}, **row})


def made_run(exp, path, tables, *, config=None, **metadata):
    """A run of an experiment from rows by table."""
    with LogWriter(path) as log:
        log.write_metadata("config", {"experiment": exp.name, **to_json(config or exp.config())})
        log.write_metadata("hosts", {"description": "made", "separate": True})
        for name, values in metadata.items():
            log.write_metadata(name, values)
        for table, rows in tables.items():
            for row in rows:
                log.write_row(table, made_row(exp, table, row), log_time_ns=1)
    return exp.load(path)
