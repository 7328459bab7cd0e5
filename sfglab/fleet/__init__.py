"""Fleets: what every agent of one runs, after paper A, section 4, and the file that describes them all."""
