"""Paper A: what every agent of a fleet runs. Here so far: the decoder (section 4.3)."""

__all__: list[str] = []
