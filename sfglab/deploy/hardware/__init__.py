"""Hardware of a machine from its files alone, by which paper A, section 4.4, chooses an image's base."""
