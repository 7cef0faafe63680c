"""Named tuples whose attributes are constants of compiled code."""

from __future__ import annotations

from functools import cache
from typing import Any

from numba import types
from numba.core.imputils import lower_constant
from numba.extending import models, overload_attribute, register_model, typeof_impl


class ConstantType(types.Opaque):
    """Type of one instance of a class of :func:`compile_time_constant`."""

    def __init__(self, value: Any) -> None:
        self.value = value
        super().__init__(f"{type(value).__name__}{tuple(value)}")


register_model(ConstantType)(models.OpaqueModel)


@lower_constant(ConstantType)
def _lower_constant(context: Any, builder: Any, constant_type: ConstantType, value: Any) -> Any:
    return context.get_dummy_value()


def compile_time_constant(named_tuple: Any) -> Any:
    """Class decorator: attributes of its instances are constants to functions of :func:`inline` and
    :func:`helper`.

    An entry point closes over the instance and passes it on whole. Branches on its attributes that
    are not taken are not compiled.
    """

    @typeof_impl.register(named_tuple)
    def constant_type(value: Any, context: Any) -> ConstantType:
        return ConstantType(value)

    for name in dir(named_tuple):
        is_property = isinstance(getattr(named_tuple, name), property)
        if is_property or name in named_tuple._fields:
            _add_attribute(name)
    return named_tuple


@cache
def _add_attribute(name: str) -> None:
    """Makes numba read an attribute where :mod:`lean` has not replaced it."""

    def reader(value: Any) -> Any:
        return lambda constant: value

    # numba compares the arguments of both functions with their annotations: there are none
    add = overload_attribute(ConstantType, name)
    add(lambda constant: reader(getattr(constant.value, name)))
