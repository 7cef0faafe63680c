"""What results have in common."""

from typing import Any

from cablebot_gym.utils.files import json_text


class Printed:
    """An object whose ``repr``, which notebooks show, is the sentence of its ``str``."""

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
