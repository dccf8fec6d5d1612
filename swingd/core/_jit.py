"""The numba policy, whole: every kernel is compiled when its module is imported, for one signature, and cached.

Kernels return status codes and write their results into arguments; they never raise. Fast-math stays off, because the
health of the filter is judged by ``isfinite``.

numba notices a change of the file that holds a kernel, not of the files whose kernels it calls. The cache folder
therefore carries a checksum of this whole room: code that was changed is never run from an old cache.
"""

import os
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import numba

F8 = numba.float64
I8 = numba.int64
VOID = numba.void
VEC = numba.float64[::1]
MAT = numba.float64[:, ::1]

_F = TypeVar("_F", bound=Callable[..., Any])


def _cache_folder() -> str:
    room = Path(__file__).parent
    checksum = 0
    for source in sorted(room.glob("*.py")):
        checksum = zlib.crc32(source.read_bytes(), checksum)
    base = os.environ.get("NUMBA_CACHE_DIR") or os.path.join(
        os.environ.get("XDG_CACHE_HOME") or os.path.join(os.path.expanduser("~"), ".cache"), "swingd"
    )
    return os.path.join(base, f"kernels-{checksum:08x}")


def is_compiled(module: str = "swing_ekf") -> bool:
    """Whether the kernels of a module of this room have been compiled and kept before."""
    return any(Path(_cache_folder()).glob(f"*/{module}.*.nbi"))


setattr(numba.config, "CACHE_DIR", _cache_folder())  # noqa: B010  (numba declares its settings at run time)


def kernel(signature: Any) -> Callable[[_F], _F]:
    """Compile a kernel for ``signature``, for example ``VOID(VEC, MAT, F8)``."""
    decorator: Callable[[_F], _F] = numba.njit(signature, cache=True, error_model="numpy")
    return decorator
