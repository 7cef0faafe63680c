"""Reference policies. They use the public face of :mod:`cablebot_gym` and nothing else."""
