"""Standard streams that never stop a command, even if they are closed, full, or without an encoding
for some characters."""

from __future__ import annotations

import codecs
import io
import json
import os
import select
import sys
from contextlib import suppress
from typing import Any

_ESCAPES = "cablebot_gym.escapes"


def _escaped(error: UnicodeError) -> tuple[str, int]:
    r"""Replaces characters without an encoding by ``\uXXXX``, their notation in JSON."""
    if not isinstance(error, UnicodeEncodeError):
        raise error
    return json.dumps(error.object[error.start : error.end])[1:-1], error.end


codecs.register_error(_ESCAPES, _escaped)


class _Output(io.RawIOBase):
    """A stream of bytes whose writes never fail. After an error, its bytes go to another stream.

    Args:
        raw: stream of the operating system.
        fallback: stream for the bytes after an error; None to drop them.
    """

    def __init__(self, raw: Any, fallback: Any) -> None:
        self._raw = raw
        self._fallback = fallback
        self._is_broken = False
        self.problem = ""
        """Error message of the operating system; empty if there is none, or if the reader has
        closed the pipe."""

    def writable(self) -> bool:
        return True

    def fileno(self) -> int:
        return int(self._raw.fileno())

    def isatty(self) -> bool:
        return bool(self._raw.isatty())

    def write(self, data: Any) -> int:
        while not self._is_broken:
            try:
                count = self._raw.write(data)
            except BrokenPipeError:
                # As in `| head`: nobody reads on, but the command may still write files.
                self._is_broken = True
                self._fallback = None
            except OSError as error:
                self._is_broken = True
                self.problem = error.strerror or str(error)
            else:
                if count is not None:
                    return int(count)
                select.select([], [self._raw], [])  # a full pipe that does not block
        if self._fallback is not None:
            with suppress(OSError):
                self._fallback.write(data)
                self._fallback.flush()
        return len(data)


def protect_streams() -> None:
    """Replaces the standard streams by streams that never fail, except those that a test or a
    notebook has set."""
    if sys.stdin is None:
        sys.stdin = open(os.devnull, encoding="utf-8")  # noqa: SIM115, for the life of the process
    sys.stderr = _protected(sys.stderr, sys.__stderr__, None)
    sys.stdout = _protected(sys.stdout, sys.__stdout__, getattr(sys.stderr, "buffer", None))


def _protected(stream: Any, original: Any, fallback: Any) -> Any:
    if stream is None:
        return open(os.devnull, "w", encoding="utf-8")
    if stream is not original:
        return stream
    # An unbuffered stream has no raw one.
    output = _Output(getattr(stream.buffer, "raw", stream.buffer), fallback)
    return io.TextIOWrapper(
        io.BufferedWriter(output),
        encoding=stream.encoding,
        errors=_ESCAPES,
        line_buffering=stream.line_buffering,
    )


def output_problem() -> str:
    """Why standard output could not be written; empty if it was written, or if its reader has
    closed the pipe."""
    sys.stdout.flush()
    raw = getattr(getattr(sys.stdout, "buffer", None), "raw", None)
    if isinstance(raw, _Output):
        return raw.problem
    return ""
