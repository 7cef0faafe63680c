"""``cablebot report``: a benchmark's results as one page that needs no network."""
