"""Windows with SDL's dummy driver."""

import sys

import pytest

from cablebot_gym.rendering.painter import import_pygame
from cablebot_gym.rendering.window import Window

pygame = import_pygame()


@pytest.fixture
def window():
    opened = Window("a test")
    yield opened
    opened.close()


def picture(colour):
    surface = pygame.Surface((64, 48))
    surface.fill(colour)
    return surface


def test_closed_window_stays_closed(window):
    window.show(picture("black"), 1000)
    pygame.event.post(pygame.event.Event(pygame.QUIT))
    window.show(picture("black"), 1000)
    assert window.closed
    assert not pygame.display.get_init()
    window.show(picture("black"), 1000)
    assert not pygame.display.get_init()


def test_window_without_display_logs_and_is_dummy(monkeypatch, caplog, window):
    monkeypatch.setattr(sys, "platform", "linux")
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "SDL_VIDEODRIVER"):
        monkeypatch.delenv(name, raising=False)
    window.show(picture("black"), 1000)
    assert (
        "No display for a window: use render_mode='rgb_array', or `cablebot video`" in caplog.text
    )
    assert pygame.display.get_driver() == "dummy"
