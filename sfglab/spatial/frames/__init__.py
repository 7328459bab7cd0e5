"""Frames with time: a buffer of transforms, look-up at any time within it, names with prefixes, and a lint."""
