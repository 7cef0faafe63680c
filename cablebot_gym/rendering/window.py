"""A window that shows pictures."""

from __future__ import annotations

import logging
import os
import sys
from typing import TYPE_CHECKING

from cablebot_gym.rendering.painter import import_pygame

if TYPE_CHECKING:
    import pygame

_LOGGER = logging.getLogger("cablebot_gym")

_NO_DISPLAY = (
    "No display for a window: use render_mode='rgb_array', or `cablebot video`. The pictures are "
    "painted but not shown."
)


class Window:
    """A window that opens with the first picture. Without a display, it uses SDL's dummy driver, as
    the windows of Gymnasium's own environments do, and writes a log message.

    Args:
        caption: title of the window.

    Raises:
        ImportError: if pygame is missing.
    """

    def __init__(self, caption: str) -> None:
        self._pygame = import_pygame()
        self._caption = caption
        self._screen: pygame.Surface | None = None
        self._clock = self._pygame.time.Clock()
        self.closed = False
        """Whether the user or :meth:`close` has closed the window."""

    def show(self, picture: pygame.Surface, rate: float) -> None:
        """Shows a picture. The call waits so that at most ``rate`` pictures are shown per second. It
        has no effect after the window was closed."""
        if self.closed:
            return
        if self._screen is None:
            self._screen = self._open(picture.get_size())
        if self._pygame.event.get(self._pygame.QUIT):
            self.close()
            return
        self._screen.blit(picture, (0, 0))
        self._pygame.display.flip()
        self._clock.tick(rate)

    def _open(self, size: tuple[int, int]) -> pygame.Surface:
        display = self._pygame.display
        variables = ("DISPLAY", "WAYLAND_DISPLAY", "SDL_VIDEODRIVER")
        # Without these variables, SDL selects a driver without output.
        found = sys.platform != "linux" or any(os.environ.get(name) for name in variables)
        try:
            if found:
                display.init()
        except self._pygame.error:
            found = False
        if not found:
            _LOGGER.warning(_NO_DISPLAY)
            os.environ["SDL_VIDEODRIVER"] = "dummy"
            display.init()
        display.set_caption(self._caption)
        return display.set_mode(size)

    def close(self) -> None:
        """Closes the window, if it is open. It cannot be opened again."""
        self.closed = True
        if self._screen is not None:
            self._screen = None
            self._pygame.display.quit()
