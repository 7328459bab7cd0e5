"""Factors between units, each defined only here."""

NS_PER_S = 1_000_000_000
NS_PER_MS = 1_000_000
BITS_PER_BYTE = 8
BITS_PER_MBIT = 1_000_000
