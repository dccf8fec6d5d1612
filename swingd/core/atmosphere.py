"""International Standard Atmosphere of the troposphere."""

from swingd.core._jit import F8, kernel
from swingd.core.constants import GRAVITY_MPS2

SEA_LEVEL_K = 288.15
SEA_LEVEL_PA = 101325.0
LAPSE_K_PER_M = 0.0065
GAS_CONSTANT = 287.05287
"""Of dry air [J/(kg K)]."""


@kernel(F8(F8))
def air_density(altitude_m):
    """Density of the air [kg/m^3] at a geopotential altitude below 11 km [m]."""
    temperature = SEA_LEVEL_K - LAPSE_K_PER_M * altitude_m
    pressure = SEA_LEVEL_PA * (temperature / SEA_LEVEL_K) ** (GRAVITY_MPS2 / (GAS_CONSTANT * LAPSE_K_PER_M))
    return pressure / (GAS_CONSTANT * temperature)
