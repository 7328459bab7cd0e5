"""The laboratory: test hosts, meters, experiments, figures, claims and the notebook runner."""

__all__: list[str] = []
