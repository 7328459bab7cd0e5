"""The laboratory: test hosts, meters, experiments, figures, claims and the notebook runner.

Modules are imported by name (``from sfglab.lab import claims``): each brings its own heavy libraries.
"""

__all__: list[str] = []
