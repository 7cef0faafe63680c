"""A window that shows pictures, where there is a display."""

from __future__ import annotations

import os
import sys
from typing import TYPE_CHECKING

from cablebot_gym.rendering.painter import import_pygame

if TYPE_CHECKING:
    import pygame


class NoDisplayError(RuntimeError):
    """There is no display to open a window on."""


class Window:
    """Opens with the first picture, under a caption.

    Raises:
        ImportError: without pygame.
    """

    def __init__(self, caption: str) -> None:
        self._pygame = import_pygame()
        self._caption = caption
        self._screen: pygame.Surface | None = None
        self._clock = self._pygame.time.Clock()
        self.closed = False
        """Whether the user, or :meth:`close`, has closed it."""

    def show(self, picture: pygame.Surface, rate: float) -> list[str]:
        """Shows a picture, at most ``rate`` of them a second; what was typed since the last one, by the keys' names.

        Does nothing once the window has been closed.

        Raises:
            NoDisplayError: if there is no display.
        """
        if self.closed:
            return []
        if self._screen is None:
            self._screen = self._opened(picture.get_size())
        typed = []
        for event in self._pygame.event.get():
            if event.type == self._pygame.QUIT:
                self.close()
                return []
            if event.type == self._pygame.KEYDOWN:
                typed.append(str(self._pygame.key.name(event.key)))
        self._screen.blit(picture, (0, 0))
        self._pygame.display.flip()
        self._clock.tick(rate)
        return typed

    def _opened(self, size: tuple[int, int]) -> pygame.Surface:
        pygame = self._pygame
        missing = NoDisplayError("no display to open a window on: use render_mode='rgb_array', or `cablebot video`")
        variables = ("DISPLAY", "WAYLAND_DISPLAY", "SDL_VIDEODRIVER")
        if sys.platform == "linux" and not any(os.environ.get(name) for name in variables):
            raise missing  # SDL would draw where nobody looks
        try:
            pygame.display.init()
            pygame.display.set_caption(self._caption)
            return pygame.display.set_mode(size)
        except pygame.error as error:
            raise missing from error

    def close(self) -> None:
        """Closes the window, if it is open; it stays closed."""
        self.closed = True
        if self._screen is not None:
            self._screen = None
            self._pygame.display.quit()
