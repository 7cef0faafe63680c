"""Errors of code that users bring, such as a policy or a motion in a file: one sentence that names
the line."""

from __future__ import annotations

import os
from pathlib import Path
from traceback import FrameSummary, extract_tb

LONGEST_MESSAGE = 1000
"""Number of characters of an error that messages repeat."""

_LIBRARY = str(Path(os.__file__).parent) + os.sep
_PACKAGE = str(Path(__file__).parents[1]) + os.sep
"""Code that messages do not name, in addition to installed packages."""

_OWN = {"cablebot_baselines", "cablebot_winches", "cablebot_reproduction"}
"""Folders of the other packages of this project."""

_SENTENCE = "_cablebot_sentence"
"""Attribute of an error that came from another process, which has no traceback here."""


def raised(error: BaseException, verb: str = "it raised", where: str = "") -> str:
    """An error of the user's code as text with its file and line, such as ``it raised KeyError:
    'mass' (mine.py, …)``.

    Args:
        error: the error.
        verb: words before the type of the error.
        where: words after the type of the error.
    """
    text = f"{verb} {type(error).__name__}{where}"
    message = _message(error)
    if message:
        text += f": {message}"
    frames = _frames(error)
    if frames:
        text += f" ({Path(frames[-1].filename).name}, line {frames[-1].lineno})"
    return text


def sentence_of_user_code(error: BaseException) -> str:
    """The error as one sentence if it passed through code that is neither installed nor of this
    project, else empty."""
    if any(_OWN.isdisjoint(Path(frame.filename).parts) for frame in _frames(error)):
        return raised(error, "your code raised")
    return str(getattr(error, _SENTENCE, ""))


def keep_sentence(error: BaseException, sentence: str) -> None:
    """Attaches a sentence of :func:`sentence_of_user_code` to an error, which loses its traceback
    by pickling."""
    setattr(error, _SENTENCE, sentence)


def _message(error: BaseException) -> str:
    """Message of an error in at most :data:`LONGEST_MESSAGE` characters."""
    try:
        text = str(error)
    except KeyboardInterrupt:
        raise
    except BaseException:
        return "its message cannot be shown"
    if len(text) <= LONGEST_MESSAGE:
        return text
    return f"{text[:LONGEST_MESSAGE]}…"


def _frames(error: BaseException) -> list[FrameSummary]:
    """Lines that the error passed through, except for those of Python, of installed packages and of
    this package."""
    return [
        frame
        for frame in extract_tb(error.__traceback__)
        if not frame.filename.startswith(("<", _LIBRARY, _PACKAGE))
        and "site-packages" not in frame.filename
    ]
