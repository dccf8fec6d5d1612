"""The numba policy, whole: every kernel is compiled when its module is imported, for one signature, and cached.

Kernels return status codes and write their results into arguments; they never raise. Fast-math stays off, because the
health of the filter is judged by ``isfinite``.
"""

from collections.abc import Callable
from typing import Any, TypeVar

import numba
from numba.core.types import Type

F8 = numba.float64
I8 = numba.int64
VOID = numba.void
VEC = numba.float64[::1]
MAT = numba.float64[:, ::1]

_F = TypeVar("_F", bound=Callable[..., Any])


def kernel(signature: Type) -> Callable[[_F], _F]:
    """Compile a kernel for ``signature``, for example ``VOID(VEC, MAT, F8)``."""
    decorator: Callable[[_F], _F] = numba.njit(signature, cache=True, error_model="numpy")
    return decorator
