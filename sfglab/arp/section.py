"""A YAML file read key by key, where each mistake is named by file and key.

Knows mappings and plain values; refuses to know what they mean.
"""

from __future__ import annotations

from difflib import get_close_matches
from typing import TYPE_CHECKING, Any

from sfglab.errors import SfglabError

if TYPE_CHECKING:
    from collections.abc import Mapping

__all__ = ["Section", "TopicFileError", "parse"]

_REQUIRED: Any = object()


class TopicFileError(SfglabError, ValueError):
    """A file of topics does not say what it must say.

    Attributes:
        file: Name of the file.
        key: Keys from the top, as in ``topics./hello.size_bytes``.
        given: What stands there; None where nothing does.
        allowed: What is allowed in its place.
    """

    def __init__(self, file: str, key: str, given: object, allowed: str) -> None:
        self.file, self.key, self.given, self.allowed = file, key, given, allowed
        super().__init__(file, key, given, allowed)  # all arguments, so that the error survives pickling

    def __str__(self) -> str:
        given = "nothing is given" if self.given is None else f"given {self.given!r}"
        place = f"{self.file}: {self.key}" if self.key else self.file
        return f"{place}: {given}, allowed: {self.allowed}"


class Section:
    """One mapping of the file, read key by key; `close` refuses keys that nobody has read.

    Args:
        file: Name of the file.
        key: Keys from the top; empty for the whole file.
        value: What stands there.

    Raises:
        TopicFileError: It is not a mapping.
    """

    def __init__(self, file: str, key: str, value: Any) -> None:
        self.file, self.key = file, key
        self._known: set[str] = set()
        if not isinstance(value, dict):
            raise TopicFileError(file, key, value, "a mapping of keys to values")
        self.values: Mapping[Any, Any] = value

    def refusal(self, key: str, allowed: str) -> TopicFileError:
        """Return the error for what stands at a key."""
        place = f"{self.key}.{key}" if self.key else key
        return TopicFileError(self.file, place, self.values.get(key), allowed)

    def get(self, key: str, default: Any = _REQUIRED) -> Any:
        """Return what stands at a key; without a default, something must."""
        self._known.add(key)
        if key not in self.values and default is _REQUIRED:
            raise self.refusal(key, f"{key!r} is needed here")
        return self.values.get(key, default)

    def section(self, key: str) -> Section:
        """Return the mapping at a key, an empty one where there is none."""
        place = f"{self.key}.{key}" if self.key else key
        return Section(self.file, place, self.get(key, {}))

    def text(self, key: str, default: Any = _REQUIRED, *, choices: tuple[str, ...] = ()) -> str:
        """Return a text, where there are choices one of them."""
        value = self.get(key, default)
        if not isinstance(value, str) or not value:
            raise self.refusal(key, "a text")
        if choices and value not in choices:
            raise self.refusal(key, " or ".join(choices))
        return value

    def number(
        self, key: str, default: Any = _REQUIRED, *, low: float = 0.0, high: float = float("inf")
    ) -> float:
        """Return a number from one bound, included, to another, excluded."""
        value = self.get(key, default)
        if isinstance(value, bool) or not isinstance(value, int | float) or not low <= value < high:
            upper = "" if high == float("inf") else f", below {high:g}"
            raise self.refusal(key, f"a number from {low:g}{upper}")
        return float(value)

    def positive(self, key: str, default: Any = _REQUIRED) -> float:
        """Return a number above zero."""
        value = self.get(key, default)
        if isinstance(value, bool) or not isinstance(value, int | float) or not 0 < value < float("inf"):
            raise self.refusal(key, "a number above zero")
        return float(value)

    def flag(self, key: str, *, default: bool) -> bool:
        """Return true or false."""
        value = self.get(key, default)
        if not isinstance(value, bool):
            raise self.refusal(key, "true or false")
        return value

    def close(self) -> None:
        """Refuse the first key that was not read."""
        for key in self.values:
            if key not in self._known:
                near = get_close_matches(str(key), sorted(self._known), n=1)
                meant = f"; did you mean {near[0]!r}?" if near else ""
                place = f"{self.key}.{key}" if self.key else str(key)
                raise TopicFileError(self.file, place, key, ", ".join(sorted(self._known)) + meant)


def parse(text: str, file: str) -> Any:
    """Return YAML's plain values, and refuse a key that stands twice in a mapping, which its loader takes.

    Args:
        text: What stands in the file.
        file: Its name, for messages.

    Raises:
        TopicFileError: It is not YAML, or a key stands twice.
    """
    import yaml

    try:
        root = yaml.compose(text, Loader=yaml.SafeLoader)
        waiting = [root] if root is not None else []
        while waiting:
            node = waiting.pop()
            if isinstance(node, yaml.MappingNode):
                keys = [key.value for key, _ in node.value if isinstance(key, yaml.ScalarNode)]
                twice = next((key for key in keys if keys.count(key) > 1), None)
                if twice is not None:
                    raise TopicFileError(file, twice, twice, "each key once in its mapping")
                waiting += [value for _, value in node.value]
        return yaml.safe_load(text)
    except yaml.YAMLError as error:
        raise TopicFileError(file, "", " ".join(str(error).split()), "YAML") from error
