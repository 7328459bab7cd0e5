"""Processes that experiments run on their hosts, such as cameras and viewers."""

__all__: list[str] = []
