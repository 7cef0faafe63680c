"""Parameters of winches from logs, with confidence intervals, ``cablebot identify``.

Log, samples of the drive equation, regression, result: one module each.
"""

from cablebot_winches.identification.log import read_log
from cablebot_winches.identification.result import Identification, identify

__all__ = ["Identification", "identify", "read_log"]
