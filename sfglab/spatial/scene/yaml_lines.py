"""YAML that remembers where everything stands, read key by key.

Knows files, lines and key paths, and refuses what could be read in two ways: keys that stand twice, and
aliases, with which a file can contain itself. Refuses to know what a scene is.
"""

from __future__ import annotations

from difflib import get_close_matches
from typing import TYPE_CHECKING, Any

from sfglab.spatial.scene.errors import SceneError

if TYPE_CHECKING:
    from collections.abc import Iterator

    import yaml

__all__ = ["Section", "read_yaml"]

_Path = tuple[str | int, ...]
_REQUIRED: Any = object()


def read_yaml(text: str, file: str) -> Section:
    """Return the mapping that a YAML text holds.

    Args:
        text: What stands in the file.
        file: Its name, for messages.

    Raises:
        SceneError: It is not YAML, or no mapping; a key is no text or stands there twice; there is an alias.
    """
    document = _Document(text, file)
    return Section(document, (), document.value)


class _Document:
    """Plain values, and the line of each."""

    def __init__(self, text: str, file: str) -> None:
        import yaml

        self.file = file
        self._lines: dict[_Path, int] = {(): 1}
        self._seen: set[int] = set()
        try:
            loader = yaml.SafeLoader(text)
            try:
                node = loader.get_single_node()
                self.value = None if node is None else self._read(loader, node, ())
            finally:
                loader.dispose()
        except yaml.YAMLError as error:
            mark = getattr(error, "problem_mark", None)
            place = f"{file}:{mark.line + 1}" if mark else file
            raise SceneError(place, getattr(error, "problem", None) or str(error), "YAML") from error
        except RecursionError as error:
            raise SceneError(file, "YAML that is nested too deeply", "a list of objects") from error

    def place(self, path: _Path) -> str:
        """Return file, line and keys of a value; of what is missing, the line of its nearest holder."""
        known = path
        while known not in self._lines:
            known = known[:-1]
        keys = "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in path).lstrip(".")
        return f"{self.file}:{self._lines[known]}" + (f": {keys}" if keys else "")

    def _read(self, loader: yaml.SafeLoader, node: yaml.Node, path: _Path) -> Any:
        import yaml

        self._lines.setdefault(path, node.start_mark.line + 1)
        if id(node) in self._seen:
            raise SceneError(self.place(path), "an alias", "every value written out where it belongs")
        self._seen.add(id(node))
        if isinstance(node, yaml.MappingNode):
            return dict(self._pairs(loader, node, path))
        if isinstance(node, yaml.SequenceNode):
            return [self._read(loader, item, (*path, i)) for i, item in enumerate(node.value)]
        try:
            return loader.construct_object(node)
        except (ValueError, OverflowError) as error:
            raise SceneError(self.place(path), node.value, "a value that YAML can read") from error

    def _pairs(self, loader: yaml.SafeLoader, node: yaml.MappingNode, path: _Path) -> Iterator[tuple[str, Any]]:
        seen: set[str] = set()
        for key, value in node.value:
            inner = (*path, str(key.value))
            self._lines[inner] = key.start_mark.line + 1
            if key.tag != "tag:yaml.org,2002:str":
                raise SceneError(self.place(inner), key.value, "a key that is text")
            if key.value in seen:
                raise SceneError(self.place(inner), key.value, "each key once in its mapping")
            seen.add(key.value)
            yield key.value, self._read(loader, value, inner)


class Section:
    """One mapping of a file, read key by key; `close` refuses keys that nobody has read.

    Args:
        document: Where it stands.
        path: Its keys from the top.
        value: What stands there.

    Raises:
        SceneError: It is no mapping.
    """

    def __init__(self, document: _Document, path: _Path, value: Any) -> None:
        self._document = document
        self._path = path
        self._known: set[str] = set()
        if not isinstance(value, dict):
            raise SceneError(self.place, value, "a mapping of keys to values")
        self._values: dict[str, Any] = value

    @property
    def place(self) -> str:
        """File, line and keys."""
        return self._document.place(self._path)

    def place_of(self, key: str) -> str:
        """Return file, line and keys of what stands at a key."""
        return self._document.place((*self._path, key))

    def has(self, key: str) -> bool:
        """Tell whether something stands at a key."""
        self._known.add(key)
        return key in self._values

    def take(self, key: str, default: Any = _REQUIRED) -> Any:
        """Return what stands at a key, whatever it is.

        Raises:
            SceneError: Nothing does, and there is no default.
        """
        if self.has(key):
            return self._values[key]
        if default is _REQUIRED:
            raise SceneError(self.place_of(key), None, f"{key!r} is needed here")
        return default

    def whole(self, key: str, low: int, default: Any = _REQUIRED) -> int:
        """Return a whole number.

        Raises:
            SceneError: It is none, or too small.
        """
        value = self.take(key, default)
        if isinstance(value, bool) or not isinstance(value, int) or value < low:
            raise SceneError(self.place_of(key), value, f"a whole number from {low}")
        return value

    def numbers(self, key: str, count: int, default: Any = _REQUIRED) -> tuple[float, ...]:
        """Return a list of so many numbers.

        Raises:
            SceneError: It is none.
        """
        value = self.take(key, default)
        listed = value if isinstance(value, list | tuple) else ()
        if len(listed) != count or any(isinstance(n, bool) or not isinstance(n, int | float) for n in listed):
            raise SceneError(self.place_of(key), value, f"{count} numbers")
        return tuple(listed)

    def section(self, key: str) -> Section:
        """Return the mapping at a key.

        Raises:
            SceneError: Nothing, or something else, stands there.
        """
        return Section(self._document, (*self._path, key), self.take(key))

    def sections(self, key: str) -> Iterator[Section]:
        """Yield the mappings of a list, nothing where there is no list.

        Raises:
            SceneError: Something else stands there.
        """
        value = self.take(key, [])
        if not isinstance(value, list):
            raise SceneError(self.place_of(key), value, "a list")
        for position, item in enumerate(value):
            yield Section(self._document, (*self._path, key, position), item)

    def close(self) -> None:
        """Refuse the first key that was not read.

        Raises:
            SceneError: With the keys that are allowed and the one that was probably meant.
        """
        for key in self._values:
            if key not in self._known:
                close = get_close_matches(key, self._known, n=1)
                hint = f"; did you mean {close[0]!r}?" if close else ""
                raise SceneError(self.place_of(key), key, ", ".join(sorted(self._known)) + hint)
