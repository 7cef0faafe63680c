"""The figures, numbers and claims of the paper, computed again: ``cablebot reproduce``."""
