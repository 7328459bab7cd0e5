"""QoS profiles and synchronisation policies as plain values, as a file keeps them, and back. Pure."""

from __future__ import annotations

from dataclasses import asdict, fields
from typing import TYPE_CHECKING, Any

from sfglab.qos import Durability, History, QoSProfile, Reliability
from sfglab.view.errors import SettingError
from sfglab.view.sync import Approximate, Exact, Independent, Latest, SyncPolicy

if TYPE_CHECKING:
    from collections.abc import Mapping


_POLICIES: dict[str, type[SyncPolicy]] = {
    kind.__name__.lower(): kind for kind in (Independent, Exact, Approximate, Latest)
}
_ENUMS = {"reliability": Reliability, "durability": Durability, "history": History}


def qos_to_values(profile: QoSProfile) -> dict[str, Any]:
    """Return a profile as plain values."""
    return {**asdict(profile), **{name: getattr(profile, name).value for name in _ENUMS}}


def qos_from_values(values: Mapping[str, Any]) -> QoSProfile:
    """Return the profile that values stand for; what is left out has its default.

    Raises:
        SettingError: A name or a value is not allowed.
        QoSError: No middleware could honour it.
    """
    known = [field.name for field in fields(QoSProfile)]
    _check_names("qos", values, known)
    given = dict(values)
    for name, kind in _ENUMS.items():
        allowed = [member.value for member in kind]
        if name in given and given[name] not in allowed:
            raise SettingError(name, given=given[name], allowed=", ".join(allowed))
        if name in given:
            given[name] = kind(given[name])
    return QoSProfile(**given)


def sync_to_values(policy: SyncPolicy) -> dict[str, Any]:
    """Return a policy as plain values."""
    return {"policy": type(policy).__name__.lower(), **asdict(policy)}


def sync_from_values(values: Mapping[str, Any]) -> SyncPolicy:
    """Return the policy that values stand for.

    Raises:
        SettingError: There is no such policy, or a value is not allowed.
    """
    given = dict(values)
    name = given.pop("policy", None)
    if name not in _POLICIES:
        raise SettingError("policy", given=name, allowed=", ".join(_POLICIES))
    _check_names(name, given, [field.name for field in fields(_POLICIES[name])])
    return _POLICIES[name](**given)


def _check_names(what: str, values: Mapping[str, Any], known: list[str]) -> None:
    unknown = sorted(values.keys() - set(known))
    if unknown:
        raise SettingError(what, given=unknown, allowed=", ".join(known) or "nothing")
