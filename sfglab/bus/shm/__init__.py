"""Shared memory behind the bus, on one host: one copy into a memory file, none out of it.

A DDS writer or reader in a separate partition shows each endpoint in the graph, with the Unix socket of a
publisher. A publisher writes each message into a free slot of its memory file and announces the slot to every
subscriber in a datagram. The subscriber builds the message as NumPy views on its read-only map. When the last
view ends, the subscriber returns the slot in a datagram. A slot in use is never written, so there are no torn
reads and no atomics. The connection of a peer that dies is closed, which frees its slots. Nothing stays in the
file system.
"""
