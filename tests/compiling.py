"""Test processes that share compiled code: what one of them compiles, the others wait for and
load."""

import hashlib

from numba.core.caching import NullCache
from numba.core.compiler_lock import global_compiler_lock
from numba.core.dispatcher import Dispatcher


def share(folder):
    """Compiles each function with a cache in one process at a time, with a file in ``folder`` as
    lock.

    Otherwise each of two test processes compiles most kernels, before the other one has stored
    them.
    """
    try:
        import fcntl
    except ImportError:  # Windows
        return
    folder.mkdir(exist_ok=True)
    compile_alone = Dispatcher.compile

    def compile_once(dispatcher, signature):
        if isinstance(dispatcher._cache, NullCache):
            return compile_alone(dispatcher, signature)
        function = dispatcher.py_func
        closed_over = [cell.cell_contents for cell in function.__closure__ or ()]
        key = f"{function.__module__}.{function.__qualname__} {closed_over} {signature}"
        path = folder / hashlib.sha256(key.encode()).hexdigest()
        # Numba's own lock comes first, in every thread: two locks in two orders would wait for each
        # other.
        with global_compiler_lock, path.open("w") as file:
            fcntl.flock(file, fcntl.LOCK_EX)
            return compile_alone(dispatcher, signature)

    Dispatcher.compile = compile_once
