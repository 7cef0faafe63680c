"""Dynamics: the textbook form (``textbook``), the compiled form (``kernel``, ``inverse``) and a
batch (``plant``)."""
