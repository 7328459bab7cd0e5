"""Compose files: the Compose Specification's own schema, and our rules on what may run how."""

from __future__ import annotations

import importlib
import re
from functools import cache
from typing import TYPE_CHECKING, Any

from sfglab.deploy.checking.compose_rules import RULES, Project
from sfglab.deploy.checking.programs import MissingProgramError
from sfglab.deploy.checking.verdicts import State, Verdict, verdict_of
from sfglab.deploy.errors import DeployError
from sfglab.documents import Document, DocumentError

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from sfglab.deploy.deployment import Deployment
    from sfglab.deploy.files import BundleFile


BASE, OVERLAY = "compose.yaml", "compose.dev.yaml"
SCHEMA = "Compose Specification"
_LIBRARY = "check_jsonschema"
_VARIABLES = ("release.env",)
_ASSIGNMENT = re.compile(r"^(?:export )?([A-Za-z_]\w*)=", re.MULTILINE)


def check_compose(files: Mapping[str, BundleFile], deployment: Deployment) -> tuple[Verdict, ...]:
    """Return one verdict about each rule for the agent's project and for its overlay for development.

    Args:
        files: The agent's folder.
        deployment: What the fleet file says, which decides about networks and devices.
    """
    verdicts: list[Verdict] = []
    base: dict[str, Any] = {}
    variables = _defined(files)
    for name in (BASE, OVERLAY):
        try:
            values = _services_of(files, name)
        except DeployError as error:
            verdicts.append(Verdict(check=SCHEMA, subject=name, state=State.FAILS, says=str(error)))
            continue
        verdicts.append(verdict_of(SCHEMA, name, _by_schema, values))
        project = Project(
            values=values, base=base, overlay=name == OVERLAY, deployment=deployment, variables=variables
        )
        verdicts += _by_rules(project, name)
        base = values
    return tuple(verdicts)


def _by_rules(project: Project, name: str) -> Iterator[Verdict]:
    for rule in RULES:
        if rule.overlay or not project.overlay:
            yield verdict_of(rule.name, name, rule.wrong, project)


def _services_of(files: Mapping[str, BundleFile], name: str) -> dict[str, Any]:
    """Return a project with services that rules can be asked about."""
    if name not in files:
        raise DeployError("there is no such file")
    try:
        values: Any = Document(files[name].text, name).value
    except DocumentError as error:
        raise DeployError(str(error)) from error
    services = values.get("services") if isinstance(values, dict) else None
    if not isinstance(services, dict) or not all(isinstance(service, dict) for service in services.values()):
        raise DeployError("services: allowed is a mapping of services, each a mapping")
    return dict(values)


def _by_schema(values: Any) -> Iterator[str]:
    try:
        schemas = importlib.import_module(f"{_LIBRARY}.builtin_schemas")
        validators = importlib.import_module("jsonschema.validators")
    except ImportError as error:
        raise MissingProgramError(_LIBRARY.replace("_", "-")) from error
    for wrong in _validator(schemas, validators).iter_errors(values):
        yield f"{wrong.json_path.removeprefix('$.')}: {wrong.message}"


@cache
def _validator(schemas: Any, validators: Any) -> Any:
    """Return what checks Compose files, made once: a fleet has many."""
    schema = schemas.get_builtin_schema("vendor.compose-spec")
    return validators.validator_for(schema)(schema)


def _defined(files: Mapping[str, BundleFile]) -> frozenset[str]:
    texts = (files[name].text for name in _VARIABLES if name in files)
    return frozenset(name for text in texts for name in _ASSIGNMENT.findall(text))
