"""Comparison of the model with public logs of real robots, ``cablebot validate``.

A study is a function that compares a robot with its logs. A new one needs a module, a row in
:data:`STUDIES`, and the address and the hashes of its files in ``sources.toml``.
"""

from collections.abc import Callable, Mapping

from cablebot_winches.reality import gch_klaus, innopolis, irma, ttk4900
from cablebot_winches.reality.comparison import Validation

STUDIES: dict[str, Callable[[Mapping[str, bytes]], Validation]] = {
    "ttk4900": ttk4900.validate,
    "gch-klaus": gch_klaus.validate,
    "irma": irma.validate,
    "innopolis": innopolis.validate,
}
"""Studies by name. Each takes the contents of its files by their paths in the repository."""
