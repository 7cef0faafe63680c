"""Episodes of policies as films: side by side, in a file or in a window."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cablebot_gym.evaluation.constraints import DLCCMonitor, Verdict
from cablebot_gym.evaluation.rollout import record_rollout
from cablebot_gym.kinematics import Array
from cablebot_gym.policies import name_of
from cablebot_gym.rendering.moment import Moment, Scene
from cablebot_gym.rendering.painter import SIZE, Painter, as_array, import_pygame
from cablebot_gym.rendering.window import Window
from cablebot_gym.utils.files import usable_file, write_whole
from cablebot_gym.video import SPEED

RATE = 30
"""Pictures a second."""

GIF_RATE = 25
"""The same of a GIF, whose pictures last whole hundredths of a second."""

STILL = 1.0
"""How long the end stays [s]."""

SUFFIXES = (".mp4", ".gif")
"""Formats of a film."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Film:
    """One episode, moment by moment."""

    scene: Scene
    """What stays the same."""
    moments: tuple[Moment, ...]
    """At the start and after every control step."""
    verdict: Verdict
    """Under the task criterion."""

    def at(self, time: float) -> int:
        """Place of the last moment that is not later than a time [s]."""
        times = [moment.time for moment in self.moments]
        return max(int(np.searchsorted(times, time + 1e-9, side="right")) - 1, 0)

    def note(self, place: int) -> str:
        """What is to be said at the moment of this place: what gave way, once it has, and the verdict at the end."""
        limit, now = self.verdict.limit, self.moments[place].time
        if limit is not None and (limit.time or 0.0) <= now + 1e-9:
            return f"not carried: {limit}"
        return "carried" if self.verdict.carried and place == len(self.moments) - 1 else ""

    @property
    def trail(self) -> Array:
        """Poses (k, n), one for each moment."""
        return np.array([moment.pose for moment in self.moments])


def film(policy: Any, env_id: str, *, title: str | None = None, **keywords: Any) -> Film:
    """An episode of a policy.

    Args:
        policy: an object with ``predict``, a callable, or a name as on the command line.
        env_id: one of :data:`cablebot_gym.ENV_IDS`.
        title: words above the picture; the policy's name and the environment if not given.
        keywords: for :func:`~cablebot_gym.evaluation.rollout.record_rollout`.

    Raises:
        ValueError: if an argument is not valid.
        cablebot_gym.policies.PolicyError: if the policy raises or returns anything but finite drive commands.
    """
    scenes: list[Scene] = []
    moments: list[Moment] = []

    def look(env: DLCCMonitor) -> None:
        if not scenes:
            scenes.append(env.get_wrapper_attr("scene"))
        moments.append(env.get_wrapper_attr("moment"))

    recorded = record_rollout(policy, env_id, look=look, **keywords)
    title = f"{name_of(policy)} on {env_id}" if title is None else title
    return Film(scene=replace(scenes[0], title=title), moments=tuple(moments), verdict=recorded.verdict)


class Projector:
    """Paints films side by side, at the same instant of each.

    Args:
        films: at least one.
        size: of each picture [pixels].

    Raises:
        ImportError: without pygame.
        ValueError: if the size is too small.
    """

    def __init__(self, films: Sequence[Film], size: tuple[int, int] = SIZE) -> None:
        self.films = films
        self._painters = [Painter(one.scene, size) for one in films]
        self._trails = [one.trail for one in films]
        self.size = (size[0] * len(films), size[1])
        """Of all together [pixels]."""
        self.duration = max(one.moments[-1].time for one in films)
        """Of the longest [s]."""

    def surfaces(self, time: float) -> Iterator[Any]:
        """A picture of each film at a time [s]."""
        for one, painter, trail in zip(self.films, self._painters, self._trails, strict=True):
            place = one.at(time)
            note = one.note(place)
            yield painter.paint(one.moments[place], trail[: place + 1], note, good=note == "carried")

    def array(self, time: float) -> NDArray[np.uint8]:
        """All pictures at a time [s] as one (height, width, 3)."""
        return np.concatenate([as_array(surface) for surface in self.surfaces(time)], axis=1)

    def times(self, speed: float, rate: float) -> Array:
        """Instants of the pictures of a whole film [s], whose end stays for a while.

        There are ``rate`` of them a second, at a speed that is a share of the episode's own.
        """
        moving = np.arange(math.ceil(self.duration * rate / speed) + 1) * speed / rate
        return np.concatenate([np.minimum(moving, self.duration), np.full(round(STILL * rate), self.duration)])


def check_film(path: Path) -> None:
    """Refuses a path whose format is not known, before the work.

    Raises:
        ValueError: naming the known ones.
        ImportError: if what writes the format is missing, naming the extra.
    """
    if path.suffix not in SUFFIXES:
        raise ValueError(f"cannot film to {str(path)!r}: the file name has to end in {' or '.join(SUFFIXES)}")
    usable_file(path)
    try:
        if path.suffix == ".gif":
            import PIL.Image  # noqa: F401
        else:
            import imageio_ffmpeg  # noqa: F401
    except ImportError as error:
        raise ImportError(f"{path.suffix} files need the extra: pip install 'cablebot-gym[render]'") from error


def check_speed(speed: float) -> float:
    """A speed that can be played.

    Raises:
        ValueError: if it is not between 1/100 and 10.
    """
    if not 0.01 <= speed <= 10:
        raise ValueError(f"speed must lie between 0.01 and 10, a share of the episode's own, not {speed:g}")
    return speed


def write_film(
    path: Path,
    films: Sequence[Film],
    *,
    speed: float = SPEED,
    size: tuple[int, int] = SIZE,
    progress: Callable[[int, int], None] = lambda done, expected: None,
) -> None:
    """Writes films side by side to an ``.mp4`` (H.264) or a ``.gif``, whole or not at all.

    Args:
        path: its suffix says which.
        films: at least one.
        speed: as a share of the episode's own.
        size: of each picture, even numbers [pixels].
        progress: called with the number of pictures done and of all.

    Raises:
        ValueError: if the format, the speed or the size is not valid.
        ImportError: if what writes the format is missing, naming the extra.
    """
    check_film(path)
    check_speed(speed)
    if any(side % 2 for side in size):
        raise ValueError(f"a film has an even number of pixels either way, not {size[0]} × {size[1]}")
    projector = Projector(films, size)
    rate = GIF_RATE if path.suffix == ".gif" else RATE
    times = projector.times(speed, rate)

    def pictures() -> Iterator[NDArray[np.uint8]]:
        for done, time in enumerate(times.tolist(), 1):
            yield projector.array(time)
            progress(done, len(times))

    write = _write_gif if path.suffix == ".gif" else _write_mp4
    write_whole(path, lambda temporary: write(temporary, pictures(), projector.size, rate))


def _write_mp4(path: Path, pictures: Iterator[NDArray[np.uint8]], size: tuple[int, int], rate: int) -> None:
    from imageio_ffmpeg import write_frames

    writer = write_frames(str(path), size, fps=rate, codec="libx264", macro_block_size=2, ffmpeg_log_level="error")
    writer.send(None)
    try:
        for picture in pictures:
            writer.send(picture)
    finally:
        writer.close()


def _write_gif(path: Path, pictures: Iterator[NDArray[np.uint8]], size: tuple[int, int], rate: int) -> None:
    from PIL import Image

    images = (Image.fromarray(picture).quantize(128, dither=Image.Dither.NONE) for picture in pictures)
    first = next(images)
    with path.open("wb") as file:  # Pillow leaves its own open after an interrupt
        first.save(file, format="GIF", save_all=True, append_images=images, duration=1000 // rate, loop=0)


def play(films: Sequence[Film], *, speed: float = SPEED, size: tuple[int, int] = SIZE) -> None:
    """Shows films side by side in a window, again and again, until it is closed.

    Space stops and goes on, the arrows go a picture back or on, r starts again, q or Esc ends.

    Raises:
        NoDisplayError: if there is no display.
        ValueError: if the speed or the size is not valid.
        ImportError: without pygame.
    """
    check_speed(speed)
    projector = Projector(films, size)
    window = Window("cablebot: space stops, arrows go one picture, r starts again, q ends")
    times = projector.times(speed, RATE)
    surface = import_pygame().Surface(projector.size)
    place, moving = 0, True
    try:
        while not window.closed:
            for column, picture in enumerate(projector.surfaces(times[place])):
                surface.blit(picture, (column * size[0], 0))
            step = int(moving)
            for key in window.show(surface, RATE):
                if key in ("q", "escape"):
                    return
                if key == "space":
                    moving = not moving
                step = 0 if key == "space" else {"left": -1, "right": 1, "r": -place}.get(key, step)
            place = (place + step) % len(times)
    finally:
        window.close()
