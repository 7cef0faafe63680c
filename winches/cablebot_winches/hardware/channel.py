"""Channels that carry lines of text: serial ports, and network sockets in their place."""

from __future__ import annotations

import socket
import time
from contextlib import suppress
from typing import Any, Protocol

import serial

BAUD_RATE = 115_200
"""Baud rate of a UART. USB ignores it."""

WRITE_TIMEOUT = 0.1
"""Longest time that a blocked port may hold the loop [s]."""


class Channel(Protocol):
    """A channel to a board. No method raises when the connection is lost: replies fail to come."""

    def write(self, text: str) -> None:
        """Sends lines, each with its end."""

    def read_line(self, deadline: float) -> str:
        """The next line without its end; empty if it is not complete at the deadline, which is a
        time of the loop's clock [s]."""

    def discard_input(self) -> None:
        """Drops what has come and has not been read."""

    def close(self) -> None:
        """Closes the channel."""


class SerialChannel:
    """A channel of pyserial.

    Args:
        url: name of a serial port, such as ``/dev/ttyACM0`` or ``COM3``, or a URL of pyserial, such
            as ``socket://localhost:4000``.

    Raises:
        OSError: if the port cannot be opened.
    """

    def __init__(self, url: str) -> None:
        self._port: Any = serial.serial_for_url(
            url, baudrate=BAUD_RATE, write_timeout=WRITE_TIMEOUT
        )
        self._received = b""
        if url.startswith("socket:"):
            # Without it, a command waits up to 40 ms for the confirmation of the one before.
            with socket.socket(fileno=socket.dup(self._port.fileno())) as duplicate:
                duplicate.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

    def write(self, text: str) -> None:
        """Sends lines."""
        with suppress(OSError):  # the missing reply tells it, and other boards get their lines
            self._port.write(text.encode("ascii"))

    def read_line(self, deadline: float) -> str:
        """The next line; ``deadline`` is a time of :func:`time.monotonic`."""
        while b"\n" not in self._received:
            left = deadline - time.monotonic()
            if left <= 0:
                return ""
            with suppress(OSError):
                self._port.timeout = left
                head = self._port.read(1)
                # All the rest that is there in one call: sockets do not tell how much it is.
                self._port.timeout = 0
                self._received += head + self._port.read(4096)
                continue
            return ""
        line, _, self._received = self._received.partition(b"\n")
        return line.decode("ascii", "replace").strip()

    def discard_input(self) -> None:
        """Drops what has come."""
        self._received = b""
        with suppress(OSError):
            self._port.reset_input_buffer()

    def close(self) -> None:
        """Closes the port."""
        self._port.close()
