"""Shared memory behind the bus: one copy into a memory file, none out of it, on one host.

A writer or reader in a partition of its own shows in the DDS graph that an endpoint exists and where its Unix
socket is. A publisher writes each message into a free slot of its memory file and tells every subscriber by a
datagram where it is. That builds the message as NumPy views on its read-only map, and gives the slot back by a
datagram with the last view. A slot that anybody holds is never written, so there are no torn reads and no
atomics; a peer that dies hangs up and frees its slots, and nothing stays in the file system.
"""
