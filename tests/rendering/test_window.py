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


def test_pressed_keys_are_returned_once(window):
    window.show(picture("black"), 1000)
    for key in (pygame.K_SPACE, pygame.K_LEFT):
        pygame.event.post(pygame.event.Event(pygame.KEYDOWN, key=key))
    assert window.show(picture("black"), 1000) == ["space", "left"]
    assert window.show(picture("black"), 1000) == []


def test_closed_window_stays_closed(window):
    window.show(picture("black"), 1000)
    pygame.event.post(pygame.event.Event(pygame.QUIT))
    assert window.show(picture("black"), 1000) == []
    assert window.closed
    assert not pygame.display.get_init()
    window.show(picture("black"), 1000)
    assert not pygame.display.get_init()


def test_window_without_display_raises(monkeypatch):
    monkeypatch.setattr(sys, "platform", "linux")
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "SDL_VIDEODRIVER"):
        monkeypatch.delenv(name, raising=False)
    with pytest.raises(
        RuntimeError, match=r"No display .* render_mode='rgb_array', or `cablebot video`"
    ):
        Window("a test").show(picture("black"), 1000)
