"""What results have in common."""

from collections.abc import Callable
from typing import Any, ClassVar

from cablebot_gym.utils.files import json_text


class Printed:
    """An object whose ``repr``, which notebooks show, is the sentence of its ``str``. They show the
    figure of a result, too."""

    figure_png: ClassVar[Callable[[Any], bytes | None]] = lambda result: None
    """The figure of a result as PNG; the package sets it, because figures need all results."""

    def __repr__(self) -> str:
        return str(self)

    def _repr_png_(self) -> bytes | None:
        return self.figure_png()


class Result(Printed):
    """A result with JSON-able data."""

    def to_dict(self) -> dict[str, Any]:
        """JSON-able data."""
        raise NotImplementedError

    def to_json(self) -> str:
        """The data as JSON, indented."""
        return json_text(self.to_dict())
