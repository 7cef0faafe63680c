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

_NO_DISPLAY = "No display for a window: use render_mode='rgb_array', or `cablebot video`."


class NoDisplayError(RuntimeError):
    """There is no display for a window."""


class Window:
    """A window that opens with the first picture.

    Args:
        caption: title of the window.
        needs_display: whether to raise an error if there is no display. If False, the window then
            uses SDL's dummy driver, as the windows of Gymnasium's own environments do, and writes a
            log message.

    Raises:
        ImportError: if pygame is missing.
    """

    def __init__(self, caption: str, *, needs_display: bool = True) -> None:
        self._pygame = import_pygame()
        self._caption = caption
        self._needs_display = needs_display
        self._screen: pygame.Surface | None = None
        self._clock = self._pygame.time.Clock()
        self.closed = False
        """Whether the user or :meth:`close` has closed the window."""

    def show(self, picture: pygame.Surface, rate: float) -> list[str]:
        """Shows a picture, and returns the names of the keys pressed since the last picture.

        The call waits so that at most ``rate`` pictures are shown per second. It has no effect
        after the window was closed.

        Raises:
            NoDisplayError: if there is no display and the window needs one.
        """
        if self.closed:
            return []
        if self._screen is None:
            self._screen = self._open(picture.get_size())
        pressed = []
        for event in self._pygame.event.get():
            if event.type == self._pygame.QUIT:
                self.close()
                return []
            if event.type == self._pygame.KEYDOWN:
                pressed.append(str(self._pygame.key.name(event.key)))
        self._screen.blit(picture, (0, 0))
        self._pygame.display.flip()
        self._clock.tick(rate)
        return pressed

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
            if self._needs_display:
                raise NoDisplayError(_NO_DISPLAY)
            _LOGGER.warning("%s The pictures are painted but not shown.", _NO_DISPLAY)
            before = os.environ.pop("SDL_VIDEODRIVER", None)
            os.environ["SDL_VIDEODRIVER"] = "dummy"
            display.init()
            del os.environ["SDL_VIDEODRIVER"]
            if before is not None:
                os.environ["SDL_VIDEODRIVER"] = before
        display.set_caption(self._caption)
        return display.set_mode(size)

    def close(self) -> None:
        """Closes the window, if it is open. It cannot be opened again."""
        self.closed = True
        if self._screen is not None:
            self._screen = None
            self._pygame.display.quit()
