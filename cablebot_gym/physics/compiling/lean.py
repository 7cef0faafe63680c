"""Numba's compiler, changed to make no machine code of helpers.

This module extends classes that numba does not document. If numba has changed them,
:mod:`inlining` works without this module.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Iterable
from typing import Any

from llvmlite.binding import Linkage
from llvmlite.ir.instructions import CallInstr
from numba import njit, types
from numba.core import ir
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import CompilerBase, DefaultPassBuilder
from numba.core.compiler_machinery import FunctionPass, register_pass
from numba.core.dispatcher import _FunctionCompiler
from numba.core.ir_utils import build_definitions
from numba.core.runtime.nrt import rtsys
from numba.core.untyped_passes import IRProcessing

from cablebot_gym.physics.compiling.constants import ConstantType

_NAMES = {
    JITCodeLibrary: "add_ir_module add_linking_library codegen enable_object_caching finalize "
    "get_pointer_to_function _final_module _finalized _get_module_for_linking _linking_libraries "
    "_shared_module",
    CompilerBase: "define_pipelines state",
    DefaultPassBuilder: "define_nopython_pipeline",
    _FunctionCompiler: "fold_argument_types",
}
"""Attributes and methods on which this module depends."""


def _check_names() -> None:
    """Checks that numba's classes still have the names above, without making instances.

    Raises:
        ImportError: if a name is missing.
    """
    for checked, names in _NAMES.items():
        known = set(dir(checked))
        for parent in checked.__mro__:
            code = getattr(parent.__init__, "__code__", None)
            if code is not None:
                known.update(code.co_names)  # attributes that it sets
        missing = set(names.split()) - known
        if missing:
            raise ImportError(f"numba's {checked.__name__} has no {min(missing)}")


_check_names()


@register_pass(mutates_CFG=False, analysis_only=False)
class _ReadConstants(FunctionPass):
    """Replaces attributes of compile-time constants by their values, before numba removes
    branches."""

    _name = "read_constants"

    def __init__(self) -> None:  # numba's method is abstract
        super().__init__()

    def run_pass(self, state: Any) -> bool:
        """Changes the function's code and returns whether it did."""
        assignments = []
        for block in state.func_ir.blocks.values():
            assignments += block.find_insts(ir.Assign)
        constants = {}
        for assignment in assignments:
            value = assignment.value
            if isinstance(value, ir.Arg) and isinstance(state.args[value.index], ConstantType):
                constants[assignment.target.name] = state.args[value.index].value
        for assignment in assignments:
            value = assignment.value
            if (
                isinstance(value, ir.Expr)
                and value.op == "getattr"
                and value.value.name in constants
            ):
                attribute = getattr(constants[value.value.name], value.attr)
                assignment.value = ir.Const(attribute, assignment.loc)
        if constants:  # numba's table of assignments is out of date
            state.func_ir._definitions = build_definitions(state.func_ir.blocks)
        return bool(constants)


# The address of PyObject_Call. Called as code of a helper, it raises TypeError, because its first
# argument is then a record of numba's, which is not callable.
_NOT_CALLABLE = ctypes.cast(ctypes.pythonapi.PyObject_Call, ctypes.c_void_p).value or 0


class _NoEnvironment:
    """Replaces the code generator, which would look for machine code of a helper."""

    def set_env(self, name: str, environment: Any) -> None:
        """Does nothing: only functions that Python calls need their Python environment."""


class _HelperLibrary(JITCodeLibrary):
    """LLVM code of a helper after numba's function passes, without machine code."""

    @property
    def codegen(self) -> _NoEnvironment:
        """See :class:`_NoEnvironment`."""
        return _NoEnvironment()

    def finalize(self) -> None:
        """Marks the library as complete. Only the entry point links the helpers that it calls."""
        self._finalized = True

    def get_pointer_to_function(self, name: str) -> int:
        """Address of a C function that raises TypeError: a helper has no machine code that Python
        could call."""
        return _NOT_CALLABLE

    def _get_module_for_linking(self) -> Any:
        """This helper and all helpers that it calls, directly or not, each once."""
        if self._shared_module is None:
            module = self._own_module().clone()
            linked = {self}
            pending = list(self._linking_libraries)
            while pending:
                library = pending.pop()
                if library in linked:
                    continue
                linked.add(library)
                if isinstance(library, _HelperLibrary):
                    module.link_in(library._own_module(), preserve=True)
                    pending += library._linking_libraries
                else:
                    module.link_in(library._get_module_for_linking(), preserve=True)
            self._shared_module = module
        return self._shared_module

    def _own_module(self) -> Any:
        for function in self._final_module.functions:
            if not function.is_declaration and function.linkage == Linkage.external:
                # several entry points in one process have the same helpers
                function.linkage = "linkonce_odr"
        return self._final_module


class _BorrowingLibrary(_HelperLibrary):
    """Code of a function that only reads and writes arrays of its caller, and therefore counts no
    references.

    LLVM would have to prove that each pair of counts is superfluous, and does not find all pairs in
    a large function.
    """

    def add_ir_module(self, ir_module: Any) -> None:
        """Adds a module without its counts of references.

        Raises:
            TypeError: if the function allocates memory.
        """
        self._check_allocations(ir_module.functions)
        for function in ir_module.functions:
            for block in function.blocks:
                block.instructions[:] = [
                    instruction
                    for instruction in block.instructions
                    if not _counts_references(instruction)
                ]
        super().add_ir_module(ir_module)

    def add_linking_library(self, library: Any) -> None:
        """Adds the code of a called function.

        Raises:
            TypeError: if that function allocates memory.
        """
        if library is not rtsys.library:  # numba's runtime, which is linked to every function
            self._check_allocations(library._final_module.functions)
        super().add_linking_library(library)

    def _check_allocations(self, functions: Iterable[Any]) -> None:
        for function in functions:
            if function.name.startswith("NRT_") and function.name not in _COUNTS:
                raise TypeError(
                    f"{self.name} allocates arrays: decorate it with helper, not with inline"
                )


_COUNTS = ("NRT_incref", "NRT_decref")


def _counts_references(instruction: Any) -> bool:
    return isinstance(instruction, CallInstr) and instruction.callee.name in _COUNTS


class HelperCompiler(CompilerBase):
    """Numba's compiler with the libraries and the pass above."""

    def define_pipelines(self) -> list[Any]:
        """The passes of numba's compiler and :class:`_ReadConstants`."""
        state = self.state
        library_class = _HelperLibrary
        if state.flags.forceinline:
            library_class = _BorrowingLibrary
        state.library = library_class(state.targetctx.codegen(), state.func_id.func_qualname)
        state.library.enable_object_caching()
        passes = DefaultPassBuilder.define_nopython_pipeline(state)
        passes.add_pass_after(_ReadConstants, IRProcessing)
        passes.finalize()
        return [passes]


def lean_helper(function: Callable[..., Any], *, forceinline: bool) -> Any:
    """Decorator of a helper, see :mod:`inlining`."""
    dispatcher = njit(  # type: ignore[call-overload]  # the types lack options
        forceinline=forceinline,
        error_model="numpy",
        no_cpython_wrapper=True,
        no_cfunc_wrapper=True,
        pipeline_class=HelperCompiler,
    )(function)
    fold = dispatcher._compiler.fold_argument_types

    def fold_without_literals(
        args: tuple[Any, ...], keywords: dict[str, Any]
    ) -> tuple[Any, tuple[Any, ...]]:
        """The types of the arguments, without literals: numba would compile the same code again for
        each literal."""
        signature, argument_types = fold(args, keywords)
        return signature, tuple(types.unliteral(argument_type) for argument_type in argument_types)

    dispatcher._compiler.fold_argument_types = fold_without_literals
    return dispatcher
