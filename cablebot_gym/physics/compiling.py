"""A word to the user while numba compiles: it happens once per machine and version, and may take a minute."""

from __future__ import annotations

import logging

from numba.core import event

_LOGGER = logging.getLogger("cablebot_gym")


class _Announcer(event.Listener):
    """Logs, at the level that Python shows by default, the first compilation of one of this package's kernels."""

    def __init__(self) -> None:
        self._said = False

    def on_start(self, event: event.Event) -> None:
        module = event.data["dispatcher"].py_func.__module__
        if not self._said and module.startswith("cablebot_gym."):
            self._said = True
            _LOGGER.warning(
                "compiling for this machine: up to a minute, the first time for each kind of robot and use …"
            )

    def on_end(self, event: event.Event) -> None:
        """Nothing to say."""


def announce_compilation() -> None:
    """Installs the announcer; called once, when the kernel is imported."""
    event.register("numba:compile", _Announcer())  # type: ignore[no-untyped-call]
