"""Ctrl-C while IPOPT runs. CasADi alone treats the interrupt as a failed evaluation and
continues."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any


class SolverInterrupt:
    """Stops a solver at its next iteration after Ctrl-C."""

    def __init__(self) -> None:
        self._requested = False
        self._callback: Any = None

    @contextmanager
    def watch(self) -> Iterator[None]:
        """Catches Ctrl-C within the block, stops the solver and raises the signal again at the end
        of the block.

        Outside the main thread it does nothing, because only the main thread receives signals.
        """
        before = signal.getsignal(signal.SIGINT)
        if threading.current_thread() is not threading.main_thread() or not callable(before):
            yield
            return
        self._requested = False
        signal.signal(signal.SIGINT, self._request)
        try:
            yield
        finally:
            signal.signal(signal.SIGINT, before)
        if self._requested:
            signal.raise_signal(signal.SIGINT)

    def _request(self, *_: Any) -> None:
        self._requested = True

    def callback(self, ca: Any, variables: int, constraints: int) -> Any:
        """The ``iteration_callback`` for ``nlpsol``, which needs it as long as it runs.

        Args:
            ca: the imported CasADi module.
            variables: number of variables of the solver.
            constraints: number of constraints of the solver.
        """
        sizes = {"x": variables, "lam_x": variables, "f": 1, "g": constraints, "lam_g": constraints}
        interrupt = self

        class Callback(ca.Callback):  # type: ignore[misc]
            def __init__(self) -> None:
                ca.Callback.__init__(self)
                self.construct("interrupts", {})

            def get_n_in(self) -> int:
                return int(ca.nlpsol_n_out())

            def get_n_out(self) -> int:
                return 1

            def get_sparsity_in(self, index: int) -> Any:
                size = sizes.get(ca.nlpsol_out(index), 0)
                if size == 0:
                    return ca.Sparsity(0, 0)
                return ca.Sparsity.dense(size, 1)

            def eval(self, _: Any) -> list[int]:
                return [int(interrupt._requested)]

        self._callback = Callback()  # CasADi keeps no reference
        return self._callback
