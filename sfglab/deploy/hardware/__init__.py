"""What a machine has beside its processor, from its files alone, and which codecs that lets one expect.

Paper A, section 4.4, chooses an image's base by the host's accelerator; this is what finds it.
"""
