"""List sentences that break the rules of ``book/style.md``: a hint for the reader, not a verdict.

    python tools/prose.py README.md sfglab/bus
    python tools/prose.py --update

Markdown, Markdown cells of notebooks, docstrings, comments, and help texts, errors and labels are read.
``--update`` lowers the numbers of hits that ``tests/prose_pending.json`` allows to those of today.
"""

from __future__ import annotations

import argparse
import ast
import io
import json
import re
import subprocess
import tokenize
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from collections.abc import Iterator

ROOT = Path(__file__).resolve().parent.parent
PENDING = ROOT / "tests" / "prose_pending.json"
LONGEST = 30  #: Words that a sentence may have.
_SUFFIXES = {".py", ".md", ".ipynb"}
_OTHERS = {"book/style.md", "tools/prose.py", "tests/test_prose.py"}  # they quote what is wrong
_WORDS = (
    "whoever|whatever|who joins|who asked|anew|for ever|stands? still|is said|are said|says so"
    "|ill-willed|latched past|hangs? up|went deaf|signs? of life|speaks? for|gives? way"
    "|nobody|somebody|everybody|anybody|in its turn|so often"
)
RULES = {
    "1 subject": re.compile(r"(?:^|(?<=[.!?:;] ))(?:Who|Whoever|What|Whatever|Whose) [a-z]"),
    "3 per": re.compile(
        r"\b(?:a|an|one) \w+ (?:a|an) (?:fault|run|line|row|cell|topic|setting|sensor|claim|bar|dot"
        r"|round|mode|process|host|agent|message|sample|picture)\b"
    ),
    "5 verbs": re.compile(rf"\b(?:{_WORDS})\b", re.IGNORECASE),
    "9 connectives": re.compile(r", for (?:it|there|they|he|we|no|a|the)\b|, too\b"),
}
_FIELD = re.compile(r"(?:Of|Whose|How|When|Where|Which|Who|What|From|To|Again)\b")
_SHOWN = {"echo", "print", "warning", "info", "error", "suptitle", "note", "annotate"}
_LABELS = {"help", "label", "title", "xlabel", "ylabel"}
_INDENTED = re.compile(r"\n\n(?: {4,}.*\n?)+")  # formulas and commands in a docstring


class Text(NamedTuple):
    """A text that people read."""

    line: int  #: Line of its beginning; in a notebook, number of the cell.
    kind: str  #: ``docstring``, ``field``, ``comment``, ``text`` or ``markdown``.
    words: str  #: The text.


def broken_rules(text: Text) -> list[str]:
    """Return the rules that a text breaks."""
    bare = re.sub(r"`[^`]*`", "X", text.words)
    found = [rule for rule, pattern in RULES.items() if pattern.search(bare)]
    if text.kind == "field" and _FIELD.match(bare):
        found.append("2 field")
    sentences = re.split(r"(?<=[.!?;:])\s+", " ".join(bare.split()))
    if text.kind != "comment" and max(len(one.split()) for one in sentences) > LONGEST:
        found.append("13 length")
    return found


def texts_of(name: str, source: str) -> Iterator[Text]:
    """Yield the texts of a file, by its name's suffix."""
    if name.endswith(".ipynb"):
        for number, cell in enumerate(json.loads(source)["cells"]):
            if cell["cell_type"] == "markdown":
                for text in _paragraphs("".join(cell["source"])):
                    yield text._replace(line=number)
    elif name.endswith(".md"):
        yield from _paragraphs(source)
    elif name.endswith(".py"):
        yield from _comments(source)
        for node in ast.walk(ast.parse(source)):
            yield from _literals(node)


def _paragraphs(source: str) -> Iterator[Text]:
    """Yield paragraphs, headings and items of lists; code and tables are left out."""
    fence = re.compile(r"```.*?```", re.DOTALL)
    plain = fence.sub(lambda code: "\n" * code.group().count("\n"), source)
    begin, words = 0, ""
    for number, line in enumerate([*plain.splitlines(), ""], 1):
        is_table = line.startswith("|")
        is_new = is_table or not line.strip() or re.match(r"\s*([-*#]|\d+\.) ", line)
        if is_new and words:
            yield Text(begin, "markdown", words)
            words = ""
        if not is_table and line.strip():
            begin = begin if words else number
            words = f"{words} {line.strip()}".strip()


def _comments(source: str) -> Iterator[Text]:
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type == tokenize.COMMENT:
            kind = "field" if token.string.startswith("#:") else "comment"
            yield Text(token.start[0], kind, token.string.lstrip("#: "))


def _literals(node: ast.AST) -> Iterator[Text]:
    is_documented = isinstance(
        node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef
    )
    if is_documented and (docstring := ast.get_docstring(node)):
        yield Text(node.body[0].lineno, "docstring", _INDENTED.sub("\n\n", docstring))
    if isinstance(node, ast.Module | ast.ClassDef):
        for before, after in zip(node.body, node.body[1:], strict=False):
            if isinstance(before, ast.Assign | ast.AnnAssign):
                yield from _text(after.value if isinstance(after, ast.Expr) else None, "field")
    if isinstance(node, ast.Call):
        name = getattr(node.func, "attr", getattr(node.func, "id", ""))
        is_shown = name in _SHOWN or name.startswith("set_") or name.endswith("Error")
        for part in node.args if is_shown else ():
            yield from _text(part, "text")
        for keyword in node.keywords:
            if keyword.arg in _LABELS:
                yield from _text(keyword.value, "text")


def _text(node: ast.AST | None, kind: str) -> Iterator[Text]:
    if isinstance(node, ast.Constant) and isinstance(node.value, str) and " " in node.value:
        yield Text(node.lineno, kind, node.value.strip())


def hits_of(path: Path) -> Iterator[tuple[Text, str]]:
    """Yield each text of a file with each rule that it breaks."""
    for text in texts_of(path.name, path.read_text(encoding="utf-8")):
        for rule in broken_rules(text):
            yield text, rule


def names_of(*places: str) -> list[str]:
    """Return the names of the project's files that are read, below these places."""
    listed = subprocess.run(
        ["git", "ls-files", *places], cwd=ROOT, capture_output=True, text=True, check=True
    )
    names = set(listed.stdout.splitlines()) - _OTHERS
    return sorted(
        name for name in names if Path(name).suffix in _SUFFIXES and (ROOT / name).is_file()
    )


def update(allowed: dict[str, int]) -> dict[str, int]:
    """Return the allowed numbers of hits, lowered to those of today."""
    lowered = {}
    for name in names_of():
        count = sum(1 for _ in hits_of(ROOT / name))
        if kept := min(count, allowed.get(name, 0)):
            lowered[name] = kept
    return lowered


def main() -> None:
    """List hits, or lower what is allowed."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("paths", nargs="*", help="files and folders to read [default: all]")
    parser.add_argument("--update", action="store_true", help="lower the allowed numbers of hits")
    options = parser.parse_args()
    if options.update:
        lowered = update(json.loads(PENDING.read_text(encoding="utf-8")))
        PENDING.write_text(json.dumps(lowered, indent=0) + "\n", encoding="utf-8")
        return
    for name in names_of(*options.paths):
        for text, rule in hits_of(ROOT / name):
            print(f"{name}:{text.line}: {rule}: {' '.join(text.words.split())[:150]}")


if __name__ == "__main__":
    main()
