"""Videos and pictures of episodes of policies, side by side, in a file."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from importlib import import_module
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cablebot_gym.evaluation.rollout import Rollout
from cablebot_gym.kinematics import Array
from cablebot_gym.rendering.painter import SIZE, Painter, as_array
from cablebot_gym.utils.checks import number
from cablebot_gym.utils.files import atomic_write, check_writable_file
from cablebot_gym.video import SPEED

RATE = 30
"""Pictures per second of playback."""

GIF_RATE = 25
"""Pictures per second of a GIF, whose frame durations are multiples of 0.01 s."""

END_TIME = 1.0
"""Time for which the last picture is shown [s]."""

SUFFIXES = (".mp4", ".gif", ".png")
"""File name suffixes of videos and of pictures."""

Episode = tuple[str, Rollout]
"""A title and the recorded episode below it."""


def note(rollout: Rollout, index: int) -> str:
    """Note below the title of the picture of moment ``index``.

    From the time of the violation on, the note states it. The last picture of an episode without a
    violation has the note "carried". Otherwise it is empty.
    """
    violation = rollout.verdict.violation
    time = rollout.moment(-1).time
    if violation is not None:
        time = violation.time or 0.0
    if time <= rollout.moment(index).time + 1e-9:
        return rollout.verdict.outcome
    return ""


class VideoPainter:
    """Paints episodes side by side, at the same time of each episode.

    Args:
        episodes: episodes to paint, at least one.
        size: width and height of each picture [pixels].

    Raises:
        ImportError: if pygame is missing.
        ValueError: if the size is too small.
    """

    def __init__(self, episodes: Sequence[Episode], size: tuple[int, int] = SIZE) -> None:
        self._rollouts = []
        self._painters = []
        self.duration = 0.0
        """Duration of the longest episode [s]."""
        for title, rollout in episodes:
            self._rollouts.append(rollout)
            self._painters.append(Painter(rollout.task, title, size))
            self.duration = max(self.duration, rollout.moment(-1).time)
        self.size = (size[0] * len(episodes), size[1])
        """Width and height of all pictures together [pixels]."""

    def array(self, time: float) -> NDArray[np.uint8]:
        """The pictures of all episodes as one array (height, width, 3), each at its last moment that
        is not later than a time [s]."""
        pictures = []
        for rollout, painter in zip(self._rollouts, self._painters, strict=True):
            index = int(np.searchsorted(rollout.arrays["time"], time + 1e-9, side="right"))
            text = note(rollout, index)
            travelled = rollout.arrays["true_pose"][:index]
            trail = np.vstack([rollout.start["true_pose"], travelled])
            surface = painter.paint(rollout.moment(index), trail, text, good=text == "carried")
            pictures.append(as_array(surface))
        return np.concatenate(pictures, axis=1)

    def times(self, speed: float, rate: float) -> Array:
        """Episode times of all pictures of the video [s]; the last picture is shown for
        :data:`END_TIME`.

        Args:
            speed: playback speed, as a fraction of real time.
            rate: pictures per second of playback.
        """
        moving = np.arange(math.ceil(self.duration * rate / speed) + 1) * speed / rate
        times = np.minimum(moving, self.duration)
        return np.pad(times, (0, round(END_TIME * rate)), constant_values=self.duration)


def check_video(path: str | Path, speed: float = SPEED) -> None:
    """Checks that a video or a picture can be written to a path, and the playback speed.

    Raises:
        ValueError: if the suffix is unknown, the path is not writable, or the speed is not between
            0.01 and 10.
        ImportError: if the package that writes the format is missing; the message gives the extra
            to install.
    """
    path = Path(path)
    if path.suffix not in SUFFIXES:
        raise ValueError(f"{str(path)!r} has to end in {' or '.join(SUFFIXES)}")
    number("speed", speed, least=0.01, most=10)
    check_writable_file(path)
    module = "PIL.Image"
    if path.suffix == ".mp4":
        module = "imageio_ffmpeg"
    try:
        import_module(module)
    except ImportError as error:
        raise ImportError(
            f"{path.suffix} files require the extra: pip install 'cablebot-gym[render]'"
        ) from error


def write_picture(
    path: str | Path,
    episodes: Sequence[Episode],
    *,
    time: float | None = None,
    size: tuple[int, int] = SIZE,
) -> None:
    """Writes a picture of episodes side by side to a ``.png`` file. The write is atomic.

    Args:
        path: file to write.
        episodes: titles and episodes to show, at least one.
        time: time of the picture [s]; None for the end of the longest episode.
        size: width and height of the picture of each episode [pixels].

    Raises:
        ValueError: if the time is negative or after the end of all episodes.
    """
    from PIL import Image

    painter = VideoPainter(episodes, size)
    if time is None:
        time = painter.duration
    time = number("time", time, least=0, most=painter.duration, unit="s")
    image = Image.fromarray(painter.array(time))
    atomic_write(path, lambda temporary: image.save(temporary, format="png"))


def write_video(
    path: str | Path,
    episodes: Sequence[Episode],
    *,
    speed: float = SPEED,
    size: tuple[int, int] = SIZE,
    progress: Callable[[int, int], None] = lambda done, expected: None,
) -> None:
    """Writes episodes side by side to an ``.mp4`` file (H.264) or a ``.gif`` file. The write is
    atomic.

    Args:
        path: file to write; its suffix determines the format.
        episodes: titles and episodes to show, at least one.
        speed: playback speed, as a fraction of real time.
        size: width and height of each picture, even numbers [pixels].
        progress: callback with the number of finished pictures and the number of all pictures.

    Raises:
        ValueError: if the format, the speed or the size is invalid.
        ImportError: if the package that writes the format is missing; the message gives the extra
            to install.
    """
    path = Path(path)
    check_video(path, speed)
    if any(side % 2 for side in size):
        raise ValueError(
            f"width and height of a video must be even numbers of pixels, not {size[0]} × {size[1]}"
        )
    painter = VideoPainter(episodes, size)
    rate = RATE
    write = _write_mp4
    if path.suffix == ".gif":
        rate = GIF_RATE
        write = _write_gif
    times = painter.times(speed, rate)

    def pictures() -> Iterator[NDArray[np.uint8]]:
        for done, time in enumerate(times.tolist(), 1):
            yield painter.array(time)
            progress(done, len(times))

    atomic_write(path, lambda temporary: write(temporary, pictures(), painter.size, rate))


def _write_mp4(
    path: Path, pictures: Iterator[NDArray[np.uint8]], size: tuple[int, int], rate: int
) -> None:
    from imageio_ffmpeg import write_frames

    writer = write_frames(
        str(path), size, fps=rate, codec="libx264", macro_block_size=2, ffmpeg_log_level="error"
    )
    writer.send(None)
    try:
        for picture in pictures:
            writer.send(picture)
    finally:
        writer.close()


def _write_gif(
    path: Path, pictures: Iterator[NDArray[np.uint8]], size: tuple[int, int], rate: int
) -> None:
    from PIL import Image

    images = (
        Image.fromarray(picture).quantize(128, dither=Image.Dither.NONE) for picture in pictures
    )
    image = next(images)
    with path.open("wb") as file:  # Pillow would leave its own file open after an interrupt
        image.save(
            file, format="GIF", save_all=True, append_images=images, duration=1000 // rate, loop=0
        )
