"""Ctrl-C while IPOPT works: CasADi alone takes the interrupt for a failed evaluation, and goes on."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any


class Interrupts:
    """Hears Ctrl-C for a solver, and stops it at its next iteration."""

    def __init__(self) -> None:
        self._heard = False

    @contextmanager
    def heard(self) -> Iterator[None]:
        """Ctrl-C within stops the solver, and is then what it is elsewhere; signals belong to the main thread alone."""
        before = signal.getsignal(signal.SIGINT)
        if threading.current_thread() is not threading.main_thread() or not callable(before):
            yield
            return
        self._heard = False
        signal.signal(signal.SIGINT, self._hear)
        try:
            yield
        finally:
            signal.signal(signal.SIGINT, before)
        if self._heard:
            signal.raise_signal(signal.SIGINT)

    def _hear(self, *_: Any) -> None:
        self._heard = True

    def callback(self, ca: Any, variables: int, constraints: int) -> Any:
        """For ``iteration_callback`` of ``nlpsol``; whoever builds the solver has to keep it.

        ``ca`` is CasADi as imported; the solver's variables and constraints are counted.
        """
        sizes = {"x": variables, "lam_x": variables, "f": 1, "g": constraints, "lam_g": constraints}
        stop = self

        class Callback(ca.Callback):  # type: ignore[misc]
            def __init__(self) -> None:
                ca.Callback.__init__(self)
                self.construct("interrupts", {})

            def get_n_in(self) -> int:
                return int(ca.nlpsol_n_out())

            def get_n_out(self) -> int:
                return 1

            def get_sparsity_in(self, place: int) -> Any:
                size = sizes.get(ca.nlpsol_out(place), 0)
                return ca.Sparsity.dense(size, 1) if size else ca.Sparsity(0, 0)

            def eval(self, _: Any) -> list[int]:
                return [int(stop._heard)]

        return Callback()
