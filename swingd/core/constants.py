"""Constants of nature that kernels and the rooms above share."""

GRAVITY_MPS2 = 9.80665
"""Standard gravity."""
