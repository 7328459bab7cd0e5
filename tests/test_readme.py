"""The README's values and verdicts are the ledger's of committed logs.

`python tests/test_readme.py` updates them.
"""

import re
from collections import Counter
from pathlib import Path

from sfglab.lab.claims import Verdict
from sfglab.lab.ledger import compute_ledger
from sfglab.lab.paths import Project

ROOT = Path(__file__).parents[1]
README = ROOT / "README.md"
COUNTS = re.compile(r"(?<=<!-- counts: tests/test_readme.py -->\n).*")
BEGIN, END = "<!-- results: tests/test_readme.py -->\n", "<!-- end of results -->\n"
DEVIATING = (
    "These claims deviate: the value in the table, or another value that the claim requires, is not accepted. "
    "A deviation is favourable if it means a smaller cost or a larger gain than in the paper, and mixed if several "
    "values differ in both directions:"
)
RESULTS = {  # what a reader takes home, its figure, and the claims about it by their methods
    "[CPU saved per additional subscriber if a stream is decoded once per device]"
    "(figures/decode_once_h264.png)": {
        "paper's: over DDS": "A-CPU-SFG",
        "sfglab variant: shared memory": "A-CPU-OURS",
    },
    "[Discovery traffic of six agents, compared with plain ROS 2](figures/discovery_fleet.png)": {
        "paper's: agents query each other": "A-DISC-BYTES",
        "sfglab variant: descriptions published, processes kept ready": "A-DISC-BYTES-OURS",
    },
    "[Time to the first image of a late-joining subscriber, compared with plain ROS 2]"
    "(figures/latency.png)": {
        "paper's": "A-FIRST",
        "sfglab variant: cache of the current group of pictures (GOP)": "A-FIRST-OURS",
    },
    "[Conditions in which local cache and balanced QoS lose the fewest messages]"
    "(figures/phases.png)": {"paper's, simulated": "B-LOSS"},
    "[Edges between software and hardware after mapping with gateways]"
    "(figures/graph_mapping.png)": {"paper's": "C-MAP"},
}


def _paper(entry):
    return "no number" if entry.claim.paper is None else f"{entry.claim.paper:g}"


def _accepted(entry):
    low, high = entry.claim.band
    return f"{low:g}" if low == high else f"{low:g} to {high:g}"


def _row(*cells):
    return f"| {' | '.join(cells)} |"


def _head(*columns):
    return [_row(*columns), "|" + "---|" * len(columns)]


def counts(whole):
    """Return the sentence of the first screen: how many claims have each verdict."""
    numbers = Counter(entry.verdict for entry in whole)
    verdicts = [f"{each.value} {numbers[each]}" for each in Verdict if numbers[each]]
    link = "[Verdicts](#how-the-numbers-are-obtained)"
    return f"{link} on {len(whole)} claims: {', '.join(verdicts)}. See [Results](#results)."


def block(whole):
    """Return the README's tables of results, as the committed logs have them."""
    ledger = {entry.claim.id: entry for entry in whole}
    lines = _head("result", "method", "paper", "accepted", "sfglab", "unit", "verdict")
    for result, claims in RESULTS.items():
        for number, (method, name) in enumerate(claims.items()):
            e = ledger[name]
            verdict = f"{e.verdict.value} ({name})"
            said = "" if number else result
            lines.append(_row(said, method, _paper(e), _accepted(e), e.value, e.unit, verdict))
    lines += ["", DEVIATING, ""]
    lines += _head("claim", "the paper's sentence", "accepted", "sfglab", "unit", "deviation")
    for e in whole:
        if e.verdict is Verdict.DEVIATES:
            claim = f"{e.claim.id} ({e.claim.where})"
            reason = "; ".join(e.reason.split("; ")[:4]).replace("|", "/")
            cells = (
                claim,
                e.claim.says,
                _accepted(e),
                e.value,
                e.unit,
                f"{e.direction}: {reason}",
            )
            lines.append(_row(*cells))
    return "\n".join(lines) + "\n"


def made():
    """Return the README with the results as they should be."""
    whole = compute_ledger(Project(root=ROOT), committed=True)
    before, begin, rest = README.read_text(encoding="utf-8").partition(BEGIN)
    _, end, after = rest.partition(END)
    return COUNTS.sub(counts(whole), before) + begin + block(whole) + end + after


def test_the_readme_has_the_figures_and_verdicts_of_the_committed_logs():
    """`python tests/test_readme.py` updates them."""
    assert README.read_text(encoding="utf-8") == made()


if __name__ == "__main__":
    README.write_text(made(), encoding="utf-8")
