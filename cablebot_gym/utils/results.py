"""What results have in common."""

import json
from typing import Any


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
        return json.dumps(self.to_dict(), indent=2, ensure_ascii=False, allow_nan=False)
