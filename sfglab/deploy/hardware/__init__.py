"""Hardware of a machine beside its processor, from its files alone, and the codecs that it lets one expect.

Paper A, section 4.4, chooses an image's base by the host's accelerator; this is what finds it.
"""
