"""From files to machines: what would change, bringing it there, and going back by a release's name."""
