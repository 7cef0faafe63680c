"""A message while numba compiles, which happens once per machine and version and takes up to a minute."""

from __future__ import annotations

import logging

from numba.core import event

_LOGGER = logging.getLogger("cablebot_gym")


class _Announcer(event.Listener):
    """Logs the first compilation of a kernel of this package, at the level that Python shows by default."""

    def __init__(self) -> None:
        self._logged = False

    def on_start(self, event: event.Event) -> None:
        module = event.data["dispatcher"].py_func.__module__
        if not self._logged and module.startswith("cablebot_gym."):
            self._logged = True
            _LOGGER.warning("compiling for this machine; this takes up to a minute, once per kind of robot and use …")

    def on_end(self, event: event.Event) -> None:
        """Does nothing."""


def announce_compilation() -> None:
    """Installs the announcer. The kernel module calls it once on import."""
    event.register("numba:compile", _Announcer())  # type: ignore[no-untyped-call]
