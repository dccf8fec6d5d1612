"""Impulse sequences of the input shapers ZV, ZVD and EI.

A command convolved with such a sequence leaves no vibration, or little, of one oscillation behind.

References
----------
.. [1] N. C. Singer and W. P. Seering, "Preshaping command inputs to reduce system vibration", Journal of Dynamic
   Systems, Measurement, and Control 112 (1), 1990, pp. 76-82.
.. [2] W. E. Singhose, W. P. Seering and N. C. Singer, "Residual vibration reduction using vector diagrams to generate
   shaped inputs", Journal of Mechanical Design 116 (2), 1994, pp. 654-659.
"""

import cmath
import math

from swingd.model.parameters import ShaperName

Impulses = tuple[tuple[float, float], ...]
"""Share and delay [s] of each impulse; the shares sum to one."""

EI_TOLERANCE = 0.05
"""Residual vibration that EI allows at the exact frequency, to be insensitive around it."""


def impulses(name: ShaperName, frequency_radps: float, damping_ratio: float) -> Impulses:
    """Compute the sequence for one oscillation.

    Parameters
    ----------
    name : ShaperName
        ZV and ZVD as in [1]_; EI as in [2]_ with a tolerance of 5 %, the undamped shares weighted with the decay of
        the oscillation between the impulses, as in the other two.
    frequency_radps : float
        Undamped angular frequency, > 0 [rad/s].
    damping_ratio : float
        0 <= damping_ratio < 1.
    """
    root = math.sqrt(1.0 - damping_ratio * damping_ratio)
    half_period_s = math.pi / (frequency_radps * root)
    decay = math.exp(-damping_ratio * math.pi / root)
    shares = {
        ShaperName.NONE: (1.0,),
        ShaperName.ZV: (1.0, 1.0),
        ShaperName.ZVD: (1.0, 2.0, 1.0),
        ShaperName.EI: (1.0 + EI_TOLERANCE, 2.0 - 2.0 * EI_TOLERANCE, 1.0 + EI_TOLERANCE),
    }[name]
    weighted = [share * decay**k for k, share in enumerate(shares)]
    total = sum(weighted)
    return tuple((share / total, k * half_period_s) for k, share in enumerate(weighted))


def residual(sequence: Impulses, frequency_radps: float, damping_ratio: float) -> float:
    """Give the vibration left by a sequence over the one left by a single impulse at its beginning, after its end.

    The percentage vibration of [1]_, equation (12) there, as a share.
    """
    end_s = sequence[-1][1]
    decay = damping_ratio * frequency_radps
    damped = frequency_radps * math.sqrt(1.0 - damping_ratio * damping_ratio)
    total = sum(share * cmath.exp(complex(decay, damped) * delay_s) for share, delay_s in sequence)
    return math.exp(-decay * end_s) * abs(total)
