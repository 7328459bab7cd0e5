"""All checks of an agent's whole folder, in memory: nothing needs to be written, built or started for them."""

from __future__ import annotations

from dataclasses import dataclass
from fnmatch import fnmatchcase
from functools import cache, partial
from typing import TYPE_CHECKING, Any

from sfglab.deploy.compose_check import check_compose
from sfglab.deploy.dockerfile_check import check_dockerfile
from sfglab.deploy.editor_check import SHAPES, check_editor
from sfglab.deploy.findings import error_sentences
from sfglab.deploy.programs import MissingProgramError, find_program
from sfglab.deploy.routers.dds_router_check import check_dds_router
from sfglab.deploy.routers.targets import ROUTER_FILES
from sfglab.deploy.routers.zenoh_check import check_zenoh
from sfglab.deploy.text_check import check_dockerfiles, check_secrets, check_shell
from sfglab.deploy.unit_check import check_unit
from sfglab.deploy.verdicts import State, Verdict, verdict_of

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping

    from sfglab.deploy.deployment import Deployment
    from sfglab.deploy.files import BundleFile
    from sfglab.fleet.lint import Finding
    from sfglab.fleet.policy import Policy


EDITOR = (".devcontainer/*", ".vscode/*")
_NO_FILE = "there is no such file"


@dataclass(frozen=True, slots=True, kw_only=True)
class OwnRules:
    """Rules of ours for files of a kind, which stand beside what renders them."""

    check: str  #: What is asked.
    pattern: str  #: Which files, as in ``systemd/*.service``; that there is one is asked too.
    #: Takes a file's text and its name without folders, returns findings; errors fail.
    rules: Callable[[str, str], Iterable[Finding]]
    program: str = ""  #: What they also ask where it is installed; empty: none.
    install: str = ""  #: The command that installs it.


OWN_RULES = (
    OwnRules(check="layers and provenance", pattern="Dockerfile", rules=check_dockerfile),
    OwnRules(
        check="service unit",
        pattern="systemd/*.service",
        rules=check_unit,
        program="systemd-analyze",
        install="apt install systemd",
    ),
)
"""Our rules for Dockerfiles and for units of systemd."""


def check_bundle(
    files: Mapping[str, BundleFile], deployment: Deployment, own: Iterable[OwnRules] = OWN_RULES
) -> tuple[Verdict, ...]:
    """Return every check's verdict about an agent's folder.

    Args:
        files: The folder: files by their paths relative to it.
        deployment: What it was made from.
        own: Rules that stand beside what renders their files.
    """
    return (
        *check_compose(files, deployment),
        *check_dockerfiles(files),
        *check_shell(files),
        *_routers(files, deployment),
        *_editor(files),
        *(verdict for rules in own for verdict in _own(rules, files)),
        *check_secrets(files),
    )


def _own(own: OwnRules, files: Mapping[str, BundleFile]) -> Iterator[Verdict]:
    names = [name for name in files if fnmatchcase(name, own.pattern)]
    if not names:
        yield Verdict(check=own.check, subject=own.pattern, state=State.FAILS, says=_NO_FILE)
    for name in names:
        yield verdict_of(own.check, name, _errors, own.rules, files[name].text, name.rpartition("/")[2])
        try:  # that a program was not asked is told by a verdict of its own
            find_program(own.program or "sh", own.install)
        except MissingProgramError as error:
            yield Verdict(check=own.program, subject=name, state=State.SKIPPED, says=str(error))


def _errors(find: Callable[..., Iterable[Finding]], *about: Any) -> Iterator[str]:
    yield from error_sentences(find(*about))


def _routers(files: Mapping[str, BundleFile], deployment: Deployment) -> Iterator[Verdict]:
    """Yield a verdict about the file of another's router; our own reads the fleet file."""
    expected = ROUTER_FILES.get(deployment.common.router, "")
    given = (name for name in files if name.startswith("router/"))
    for name in dict.fromkeys(filter(None, (expected, *given))):
        if name in files:
            yield verdict_of("router's file", name, _errors, _router, files, name, deployment.fleet.policy)
        else:
            yield Verdict(check="router's file", subject=name, state=State.FAILS, says=_NO_FILE)


def _router(files: Mapping[str, BundleFile], name: str, policy: Policy) -> tuple[Finding, ...]:
    check = check_dds_router if name.endswith((".yaml", ".yml")) else check_zenoh
    return check(files[name].text, file=name, policy=policy)


def _editor(files: Mapping[str, BundleFile]) -> Iterator[Verdict]:
    found = cache(partial(check_editor, files))
    names = {name for name in files if any(fnmatchcase(name, pattern) for pattern in EDITOR)}
    for name in sorted(names | set(SHAPES)):
        yield verdict_of("editor's file", name, _errors, _of_file, found, name)


def _of_file(found: Callable[[], Iterable[Finding]], name: str) -> Iterator[Finding]:
    yield from (finding for finding in found() if finding.place.file == name)
