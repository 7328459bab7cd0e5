"""The lengths at which an experiment can be run, by name.

Knows that a profile is a configuration with a name; refuses to know what is configured.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any, TypeVar

from sfglab.errors import SfglabError

if TYPE_CHECKING:
    from collections.abc import Mapping

    from _typeshed import DataclassInstance


T = TypeVar("T", bound="DataclassInstance")


class ConfigError(SfglabError, ValueError):
    """A configuration that cannot be run."""


def of_profile(profiles: Mapping[str, T], name: str, **changes: Any) -> T:
    """Return the configuration of a profile.

    Args:
        profiles: The experiment's configurations by name.
        name: One of them.
        changes: Fields that are set anew, as the seed.

    Raises:
        ConfigError: There is no such profile.
    """
    if name not in profiles:
        raise ConfigError(f"profile: given {name!r}, allowed are {', '.join(profiles)}")
    return replace(profiles[name], **changes)
