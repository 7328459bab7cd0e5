"""Processes that experiments put on their hosts: a camera that publishes, viewers that look."""

__all__: list[str] = []
