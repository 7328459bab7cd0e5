"""Decoding of a stream once per device, on demand: paper A, section 4.3, Fig. 4."""
