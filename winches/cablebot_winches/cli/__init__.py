"""Commands of ``cablebot`` that this package adds, one module each."""
