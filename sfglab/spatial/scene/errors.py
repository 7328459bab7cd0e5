"""The one error of scenes: where, what was given, what is allowed."""

from __future__ import annotations

from sfglab.errors import SfglabError

__all__ = ["SceneError"]


class SceneError(SfglabError, ValueError):
    """A scene, an edit of one, or a scene file that is not allowed; nothing was changed.

    Attributes:
        place: Where: an object and its property, or a file, line and key.
        given: What was given.
        allowed: What is allowed in its place.
    """

    def __init__(self, place: str, given: object, allowed: str) -> None:
        self.place = place
        self.given = given
        self.allowed = allowed
        super().__init__(place, given, allowed)  # all arguments, so that the error survives pickling

    def __str__(self) -> str:
        given = "nothing is given" if self.given is None else f"given {self.given!r}"
        return f"{self.place}: {given}, allowed: {self.allowed}"
