"""Shared memory behind the bus: one copy into a memory file, none out of it, on one host.

The control plane is the DDS graph: a writer or reader in a partition of its own shows that an
endpoint exists and where its Unix socket is. The data plane is an anonymous memory file and sequenced-packet
sockets, so a killed process leaves nothing behind: no file, no semaphore, no segment.

A publisher writes each message into a free slot of its memory file and tells every subscriber by a small
datagram where it is. The subscriber builds the message as NumPy views on its read-only map, and when the last
view is gone it gives the slot back by another datagram. A slot that anybody holds is never written, so there
are no torn reads and no atomics; a peer that dies hangs up, and its slots are free.
"""
