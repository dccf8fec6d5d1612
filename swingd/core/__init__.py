"""Numba kernels with their index and status enumerations; they know nothing of the rooms above."""
