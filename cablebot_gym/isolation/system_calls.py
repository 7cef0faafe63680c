"""System calls that a sandboxed policy may not make, because namespaces do not stop them from
leaving something for a later process of the policy."""

from __future__ import annotations

import os
import platform
import struct
from collections.abc import Iterator
from contextlib import contextmanager
from errno import ENOSYS

_REFUSED = {
    "x86_64": (0xC000003E, (248, 249, 250)),
    "aarch64": (0xC00000B7, (217, 218, 219)),
}
"""By machine: its number in the kernel's audit, and add_key, request_key and keyctl. The keyring of a
session outlives the processes that wrote into it."""

_IGNORED = {"x86_64": (132, 235, 261, 280), "aarch64": (88,)}
"""By machine: utime, utimes, futimesat and utimensat. A sandbox has device files of the machine, which
keep their times. Programs that unpack archives need these calls to succeed."""

_X32 = 0x40000000
"""Least number of the calls of the x32 interface, which are others than those above."""

_LOAD, _EQUAL, _AT_LEAST, _RETURN = 0x20, 0x15, 0x35, 0x06
"""Operations of a filter: load a word; compare it, and skip the first number of instructions if it is
equal, or at least the value, else the second number; end."""

_ALLOW = 0x7FFF0000
_ERROR = 0x00050000
"""Outcomes of a filter; an error number is added to the second, and 0 is a success."""


def call_filter() -> bytes:
    """Filter of system calls for the kernel (seccomp). It allows all of them on a machine whose
    numbers are unknown."""
    machine = platform.machine()
    allow = (_RETURN, 0, 0, _ALLOW)
    program = []
    if machine in _REFUSED:
        audit, refused = _REFUSED[machine]
        refuse = (_RETURN, 0, 0, _ERROR | ENOSYS)
        # offsets in the kernel's record of a call: 4 the machine, 0 the number
        program += [(_LOAD, 0, 0, 4), (_EQUAL, 1, 0, audit), refuse, (_LOAD, 0, 0, 0)]
        program += [(_AT_LEAST, 0, 1, _X32), refuse]
        for number in refused:
            program += [(_EQUAL, 0, 1, number), refuse]
        for number in _IGNORED[machine]:
            program += [(_EQUAL, 0, 1, number), (_RETURN, 0, 0, _ERROR)]
    program.append(allow)
    return b"".join(struct.pack("=HBBI", *instruction) for instruction in program)


@contextmanager
def filter_descriptor() -> Iterator[int]:
    """A readable file descriptor with the filter."""
    reader, writer = os.pipe()
    os.write(writer, call_filter())
    os.close(writer)
    try:
        yield reader
    finally:
        os.close(reader)
