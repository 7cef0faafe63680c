"""Commands for owners of real cable robots. This package uses only the public interface of
:mod:`cablebot_gym`."""
