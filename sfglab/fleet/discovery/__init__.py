"""Who else is in the fleet: heartbeats in, discovery events out. Paper A, section 4.2, Fig. 3.

Bottom up: `lifecycle` (the table of one remote agent's states) and `diagram` (the same for its figure),
`screening` (which heartbeats count), `orders` and `registry` (all remote agents), `history` (what consumers
that come late still hear), `node` (the discoverer), `app` (the discoverer as a process); beside them,
`listener` (the consumer's side of the events).
"""

__all__: list[str] = []
