"""Error for an unknown name, with the valid names and the closest match."""

from __future__ import annotations

from collections.abc import Iterable
from difflib import get_close_matches


def unknown_name_error(kind: str, name: object, names: Iterable[str], otherwise: str = "") -> ValueError:
    """The error to raise for an unknown name. Its message lists the valid names and suggests the closest one.

    Args:
        kind: kind of the named thing, such as ``environment``.
        name: the unknown name, as the user gave it.
        names: the valid names.
        otherwise: other valid input, such as ``, or pass a Robot``.
    """
    known = {valid.lower(): valid for valid in names}
    close = get_close_matches(str(name).strip().lower(), known, 1)
    suggestion = f"; did you mean {known[close[0]]!r}?" if close else ""
    return ValueError(f"unknown {kind} {name!r}; choose one of {', '.join(known.values())}{otherwise}{suggestion}")
