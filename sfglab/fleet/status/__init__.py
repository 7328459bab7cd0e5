"""What an agent says of itself: heartbeats and a description for whoever asks. Paper A, section 4.2.

Bottom up: `heartbeat` (names on the wire and the heartbeat as a value), `schedule` (when it beats),
`description` (what an agent is), `hardware` (what works on this machine), `provider` (the node), `app` (the
node as a process).
"""

__all__: list[str] = []
