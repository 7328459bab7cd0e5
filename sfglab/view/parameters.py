"""What can be tuned in a visualizer while it runs: names, kinds, ranges and defaults, as values.

A panel makes a widget of each; `check` is the one place that decides which values are allowed.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from sfglab.view.errors import SettingError

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping


Setting = bool | int | float | str
"""What a parameter can hold."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Parameter:
    """One thing to tune."""

    name: str  #: A Python identifier.
    default: Setting  #: Its first value, which also says its type.
    help: str  #: What it does, for people, with its unit.
    minimum: float | None = None  #: Smallest number; None for no bound.
    maximum: float | None = None  #: Largest number; None for no bound.
    choices: tuple[str, ...] = ()  #: The allowed texts; empty allows all.

    @property
    def kind(self) -> type[Setting]:
        """`bool`, `int`, `float` or `str`."""
        return type(self.default)

    @property
    def allowed(self) -> str:
        """What it takes, in words."""
        if self.kind is bool:
            return "true or false"
        if self.kind is str:
            return ", ".join(self.choices) or "any text"
        number = "whole numbers" if self.kind is int else "numbers"
        low = "" if self.minimum is None else f" from {self.minimum:g}"
        high = "" if self.maximum is None else f" to {self.maximum:g}"
        return number + low + high

    def check(self, value: object) -> Setting:
        """Return a value in the parameter's type.

        Raises:
            SettingError: It is of another type or out of range.
        """
        checked = self._converted(value)
        if isinstance(checked, str):
            fits = not self.choices or checked in self.choices
        else:
            low = -math.inf if self.minimum is None else self.minimum
            high = math.inf if self.maximum is None else self.maximum
            fits = math.isfinite(checked) and low <= checked <= high
        if not fits:
            raise SettingError(self.name, given=value, allowed=self.allowed)
        return checked

    def _converted(self, value: object) -> Setting:
        if self.kind is float and isinstance(value, int) and not isinstance(value, bool):
            return float(value)
        if type(value) is not self.kind:
            raise SettingError(self.name, given=value, allowed=self.allowed)
        return value


def check_all(parameters: Iterable[Parameter], values: Mapping[str, object]) -> dict[str, Setting]:
    """Return a value for every parameter: the given one, checked, or the default.

    Raises:
        SettingError: A value is not allowed, or belongs to no parameter.
    """
    known = {parameter.name: parameter for parameter in parameters}
    for name in values:
        if name not in known:
            raise SettingError(
                name, given=values[name], allowed=f"as a parameter: {', '.join(known) or 'none'}"
            )
    return {name: parameter.check(values.get(name, parameter.default)) for name, parameter in known.items()}
