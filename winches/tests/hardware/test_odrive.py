"""Lines, wiring and channels of the protocol."""

import socket

import numpy as np
import pytest
from clock import HANG, monotonic

from cablebot_gym.robots import find_robot
from cablebot_winches.hardware.channel import SerialChannel
from cablebot_winches.hardware.odrive import (
    Winch,
    Winches,
    parsed_numbers,
    plain_wiring,
    read_wiring,
    with_checksum,
)

TTK = find_robot("ttk4900")


def test_checksum_is_that_of_the_manual():
    assert with_checksum("r vbus_voltage ") == "r vbus_voltage *93\n"


GOOD = with_checksum("1.5 -0.25").strip()


@pytest.mark.parametrize(
    ("line", "values"),
    [
        (GOOD, [1.5, -0.25]),
        (GOOD.replace("5", "6", 1), None),
        ("1.5 -0.25", None),
        (GOOD[2:], None),
        (with_checksum("1.5").strip(), None),
        (with_checksum("1.5 nan").strip(), None),
        (with_checksum("unknown command").strip(), None),
        ("1.5 �*5", None),
        ("", None),
    ],
)
def test_only_whole_replies_are_read(line, values):
    assert parsed_numbers(line, 2) == values


class Late:
    """A channel whose first reply comes when the second question has been asked."""

    def __init__(self):
        self.asked = []

    def write(self, text):
        self.asked.append(text)

    def read_line(self, deadline):
        return "" if len(self.asked) == 1 else GOOD

    def discard_input(self):
        pass


def test_late_reply_is_not_that_of_the_next_winch():
    wiring = [Winch(port="a", axis=0), Winch(port="a", axis=1)]
    angle, speed = Winches(wiring, {"a": Late()}).feedback(0.0, 1.0)
    assert np.isnan([angle, speed]).all()


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")  # of pyserial
def test_lost_connection_gives_no_reply_and_no_error():
    """Otherwise the other winches would not be stopped."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        channel = SerialChannel(f"socket://127.0.0.1:{server.getsockname()[1]}")
        server.accept()[0].close()
    for _ in range(3):
        channel.write("f 0\n")
        channel.discard_input()
        assert channel.read_line(monotonic() + HANG) == ""
    channel.close()


TABLE = '[[winch]]\nport = "a"\naxis = {axis}\nsign = {sign}\ngear = {gear}\n'
USUAL = {"axis": 0, "sign": 1, "gear": 1}


@pytest.mark.parametrize(
    ("tables", "message"),
    [
        ([USUAL], "needs 4 tables"),
        ([USUAL] * 4, "its own port and axis"),
        ([USUAL | {"axis": 2}], "axis must be 0 or 1"),
        ([USUAL | {"sign": 0}], "sign 1 or -1"),
        ([USUAL | {"gear": 0}], "gear must be"),
    ],
)
def test_invalid_wiring_is_refused(tables, message, tmp_path):
    path = tmp_path / "wiring.toml"
    path.write_text("".join(TABLE.format(**table) for table in tables))
    with pytest.raises(ValueError, match=message):
        read_wiring(path, TTK)


def test_ports_are_those_of_two_winches_each():
    wiring = plain_wiring(["a", "b"], TTK)
    assert [(winch.port, winch.axis) for winch in wiring] == [
        ("a", 0),
        ("a", 1),
        ("b", 0),
        ("b", 1),
    ]
    with pytest.raises(ValueError, match="give --port 2 times, not 1"):
        plain_wiring(["a"], TTK)
