"""Kernels warn of nothing; run without numba, NumPy would."""

from collections.abc import Iterator
from contextlib import nullcontext

import numba
import numpy as np
import pytest


@pytest.fixture(autouse=True)
def _kernels_never_warn() -> Iterator[None]:
    with np.errstate(all="ignore") if numba.config.DISABLE_JIT else nullcontext():
        yield
