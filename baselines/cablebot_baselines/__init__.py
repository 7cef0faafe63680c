"""Reference policies for :mod:`cablebot_gym`. This package uses only the public interface of
:mod:`cablebot_gym`."""
