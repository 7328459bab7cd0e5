"""The README's figures and verdicts are the ledger's of committed logs, and its snippet runs as a script.

`python tests/test_readme.py` writes the figures anew.
"""

import os
import re
import signal
import subprocess
import sys
from collections import Counter
from contextlib import ExitStack
from pathlib import Path

import pytest

from sfglab.lab.ledger import compute_ledger
from sfglab.lab.paths import Project

ROOT = Path(__file__).parents[1]
README = ROOT / "README.md"
BEGIN, END = "<!-- results: tests/test_readme.py -->\n", "<!-- end of results -->\n"
RESULTS = {  # claim: what a reader takes home, and its figure
    "A-CPU-OURS": (
        "A stream is decoded once for all subscribers of a device (sfglab variant: shared memory)",
        "decode_once_h264",
    ),
    "A-DISC-BYTES-OURS": (
        "Six agents discover each other with fewer bytes than plain ROS 2 (sfglab variant)",
        "discovery_fleet",
    ),
    "A-FIRST-OURS": (
        "A late-joining subscriber has its first image sooner (sfglab variant: GOP cache)",
        "latency",
    ),
    "B-LOSS": (
        "Local cache and balanced QoS lose the fewest messages under plausible conditions",
        "phases",
    ),
    "C-MAP": (
        "A mapping with gateways leaves few edges between software and hardware",
        "graph_mapping",
    ),
}
INSTEAD = {  # claim: the usual method, and the component that replaces it
    "A-CPU-OURS": (
        "a decoder in each subscriber (image_transport)",
        "`sfglab decoder`, shared memory",
    ),
    "A-CPU-SFG": ("the same", "`sfglab decoder`, over DDS to ROS 2 nodes"),
    "A-DISC-BYTES-OURS": (
        "DDS discovery of all participants by all",
        "`sfglab agent up`, published descriptions",
    ),
    "A-FIRST-OURS": ("waiting for the next key frame", "the agent's GOP cache"),
    "A-RVL": ("PNG depth (compressed_depth_image_transport's), at its fastest level", "`rvl`"),
}


def _ours(entry):
    return f"{entry.value} {entry.unit}"


def _paper(entry):
    return "no number" if entry.claim.paper is None else f"{entry.claim.paper:g}"


def _head(*columns):
    return [f"| {' | '.join(columns)} |", "|" + "---|" * len(columns)]


def is_favourable(entry, ledger):
    """Return whether all values outside their acceptance ranges are on the better side.

    Of the paper's own method the ledger does not say which side is the better one; its variant does.
    """
    claim, measured = entry.claim, entry.measured
    variant = ledger.get(f"{claim.id}-OURS")
    better = claim.better or (variant and variant.claim.better)
    values = [(measured.estimate.value, claim.band)]
    values += [(measured.ends[name], band) for name, band in claim.ends.items()]
    outside = [(value, band) for value, band in values if not band[0] <= value <= band[1]]
    above = all(value > high for value, (_, high) in outside)
    below = all(value < low for value, (low, _) in outside)
    return (better == "above" and above) or (better == "below" and below)


def _deviating(entries):
    lines = _head("claim", "the paper's sentence", "paper", "sfglab", "interval", "why")
    for e in entries:
        reason = " ".join("; ".join(e.reason.split("; ")[:2]).split()).replace("|", "/")
        cells = (f"{e.claim.id} ({e.claim.where})", e.claim.says, _paper(e), _ours(e), e.interval)
        lines.append(f"| {' | '.join(cells)} | {reason} |")
    return lines


def block():
    """Return the README's results, as the committed logs have them."""
    whole = compute_ledger(Project(root=ROOT), committed=True)
    ledger = {entry.claim.id: entry for entry in whole}
    counts = Counter(entry.verdict.value for entry in whole).most_common()
    verdicts = ", ".join(f"{count} {verdict}" for verdict, count in counts)
    lines = [f"{len(whole)} claims, judged from {whole.source}: {verdicts}.", ""]
    lines += _head("result", "paper", "sfglab", "interval", "verdict")
    for name, (says, figure) in RESULTS.items():
        e = ledger[name]
        verdict = f"{e.verdict.value} ({name}, {e.measured.how.value})"
        link = f"[{says}](figures/{figure}.png)"
        lines.append(f"| {link} | {_paper(e)} | {_ours(e)} | {e.interval} | {verdict} |")
    deviating = [entry for entry in whole if entry.verdict.value == "deviates"]
    favourable = [entry for entry in deviating if is_favourable(entry, ledger)]
    lines += ["", "These claims did not hold, or not as they are stated:", ""]
    lines += _deviating(entry for entry in deviating if entry not in favourable)
    lines += ["", "Outside the acceptance range because it is better than in the paper:", ""]
    lines += _deviating(favourable)
    lines += ["", "These components of sfglab are better than the usual method:", ""]
    lines += _head("instead of", "this", "measured", "interval")
    lines += [
        f"| {other} | {this} | {_ours(ledger[name])} | {ledger[name].interval} |"
        for name, (other, this) in INSTEAD.items()
    ]
    return "\n".join(lines) + "\n"


def readme(begin, made, end):
    """Return the README with what is made between two marks as it should be."""
    before, begin, rest = README.read_text(encoding="utf-8").partition(begin)
    _, end, after = rest.partition(end)
    return before + begin + made + end + after


def test_the_readme_has_the_figures_and_verdicts_of_the_committed_logs():
    """`python tests/test_readme.py` writes them anew."""
    assert README.read_text(encoding="utf-8") == readme(BEGIN, block(), END)


@pytest.mark.live
def test_the_readmes_snippet_runs_as_a_script_beside_its_two_commands(domain_id, tmp_path):
    text = README.read_text(encoding="utf-8")
    (snippet,) = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    commands = re.findall(
        r"^\.venv/bin/sfglab ((?:camera|decoder) /.* --domain 7)$", text, re.MULTILINE
    )
    assert len(commands) == 2
    (tmp_path / "view.py").write_text(snippet.replace("domain_id=7", f"domain_id={domain_id}"))
    here = [words.replace("7", str(domain_id)).split() for words in commands]
    argvs = [[sys.executable, "-P", "-m", "sfglab", *words] for words in here]
    environment = os.environ | {
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
        "PYTHONUNBUFFERED": "1",
    }
    options = {
        "stdout": subprocess.PIPE,
        "stderr": subprocess.DEVNULL,
        "text": True,
        "env": environment,
    }
    with ExitStack() as stack:
        for argv in [*argvs, [sys.executable, "-P", tmp_path / "view.py"]]:
            process = stack.enter_context(subprocess.Popen(argv, **options))
            stack.callback(process.send_signal, signal.SIGINT)
        seen = [process.stdout.readline() for _ in range(3)]
        assert all(re.fullmatch(r"\d+ \d+\.\d+\n", line) for line in seen), seen


if __name__ == "__main__":
    README.write_text(readme(BEGIN, block(), END), encoding="utf-8")
