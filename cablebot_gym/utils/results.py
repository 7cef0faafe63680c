"""What results have in common."""

from collections.abc import Callable
from typing import Any, ClassVar

from cablebot_gym.utils.files import json_text


class Printed:
    """An object whose ``repr``, which notebooks show, is the sentence of its ``str``. They show the
    figure of a result, too."""

    _repr_png_: ClassVar[Callable[[Any], bytes | None]]
    """The figure as PNG; the package sets it, because figures need the results."""

    def __repr__(self) -> str:
        return str(self)


class Result(Printed):
    """A result with JSON-able data."""

    def to_dict(self) -> dict[str, Any]:
        """JSON-able data."""
        raise NotImplementedError

    def to_json(self) -> str:
        """The data as JSON, indented."""
        return json_text(self.to_dict())
