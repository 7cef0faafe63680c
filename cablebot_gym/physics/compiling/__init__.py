"""Compilation with numba: entry points that Python computes at first, and the helpers that they
call. The only folder that knows numba's internals.

The files from bottom to top: code_cache, loading, constants, lean, inlining, fused and
python_first.
"""

from cablebot_gym.physics.compiling.constants import compile_time_constant
from cablebot_gym.physics.compiling.fused import fma
from cablebot_gym.physics.compiling.inlining import helper, inline
from cablebot_gym.physics.compiling.python_first import compiled_at_once, entry_point

__all__ = ["compile_time_constant", "compiled_at_once", "entry_point", "fma", "helper", "inline"]
