"""The equations: to read (``textbook``), compiled (``kernel``, ``inverse``), and in MuJoCo. No rewards, no policies."""
