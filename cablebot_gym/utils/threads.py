"""Calls in parallel threads, for compiled code that releases the interpreter's lock."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cache

from cablebot_gym.utils.workers import cores


@cache
def _pool() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(cores(), thread_name_prefix="cablebot")


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_pool.cache_clear)  # threads do not survive a fork


def call_all(calls: Sequence[Callable[[], None]]) -> None:
    """Makes all calls, the first one in this thread, and returns when all have ended.

    Raises:
        Exception: the first exception of a call, after all have ended.
    """
    if len(calls) == 1:
        calls[0]()
        return
    futures = [_pool().submit(call) for call in calls[1:]]
    try:
        calls[0]()
    finally:
        errors = [future.exception() for future in futures]
    for error in errors:
        if error is not None:
            raise error
