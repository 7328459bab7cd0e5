"""The one error of scenes: where, what was given, what is allowed."""

from __future__ import annotations

from typing import TYPE_CHECKING

from sfglab.errors import SfglabError

if TYPE_CHECKING:
    from typing import Self

    from sfglab.documents import DocumentError


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

    @classmethod
    def of_document(cls, error: DocumentError) -> Self:
        """Return what a file's reader refused as an error of the scene, at the same place."""
        return cls(str(error.place), error.given, error.allowed)

    def __str__(self) -> str:
        given = "nothing is given" if self.given is None else f"given {self.given!r}"
        return f"{self.place}: {given}, allowed: {self.allowed}"
