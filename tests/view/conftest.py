"""A canvas that remembers."""

from types import SimpleNamespace

import pytest


class Paper:
    """A surface that keeps what is drawn on it."""

    def __init__(self):
        self.drawn = []
        self.frames = {}
        self.time = None
        self.closed = 0

    def log(self, entity, *what, static=False):
        self.drawn.append(SimpleNamespace(entity=entity, what=what, static=static, time=self.time))

    def place(self, entity, frame):
        if frame:
            self.frames[entity] = frame

    def at(self, *, stamp_ns, received_ns):
        self.time = (stamp_ns, received_ns)

    def settle(self, size_bytes):
        """Nothing is waited for."""

    def close(self):
        self.closed += 1

    def values(self, entity, component):
        """The values of a component that changes, as plain lists, one for each time it was drawn at an entity."""
        found = []
        for drawn in self.drawn:
            for what in drawn.what if drawn.entity == entity and not drawn.static else ():
                for batch in what.as_component_batches():
                    name = str(batch.component_descriptor()).split(":")[-1].split("#")[0]
                    if name == component:
                        found.append(batch.as_arrow_array().to_pylist())
        return found


@pytest.fixture
def paper():
    return Paper()
