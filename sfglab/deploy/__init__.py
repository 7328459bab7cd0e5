"""Paper A, section 4.4: what a real fleet is given. Here so far: configurations for other people's routers."""

__all__: list[str] = []
