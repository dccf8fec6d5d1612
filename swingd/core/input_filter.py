"""Biquads in cascade over several channels at once: low-pass and notch for the inputs of an estimator.

Whatever is subtracted from each other later must pass the same filter: force and acceleration then stay in phase, and
their difference is the filtered difference. Second-order sections by the bilinear transform with the corner's frequency
kept; S. K. Mitra, Digital signal processing (2006).
"""

from enum import IntEnum
from math import cos, pi, tan

from swingd.core._jit import F8, MAT, VEC, VOID, kernel


class Section(IntEnum):
    """Columns of a biquad: y = b0 x + b1 x1 + b2 x2 - a1 y1 - a2 y2."""

    B0 = 0
    B1 = 1
    B2 = 2
    A1 = 3
    A2 = 4
    SIZE = 5


_S = Section


@kernel(VOID(VEC, F8, F8, F8))
def low_pass(section_out, corner_hz, damping, rate_hz):
    """Second-order low-pass; damping 0.7071 is Butterworth's.

    Parameters
    ----------
    section_out : (5,), written
    corner_hz : float
        0 < corner < rate / 2 [Hz].
    damping : float
        Ratio, > 0.
    rate_hz : float
        Of the samples [Hz].
    """
    k = tan(pi * corner_hz / rate_hz)
    scale = 1.0 / (1.0 + 2.0 * damping * k + k * k)
    section_out[_S.B0] = k * k * scale
    section_out[_S.B1] = 2.0 * k * k * scale
    section_out[_S.B2] = k * k * scale
    section_out[_S.A1] = 2.0 * (k * k - 1.0) * scale
    section_out[_S.A2] = (1.0 - 2.0 * damping * k + k * k) * scale


@kernel(VOID(VEC, F8, F8, F8))
def notch(section_out, centre_hz, width_hz, rate_hz):
    """Second-order notch: nothing passes at its centre, half of the power at either side of the width.

    Parameters
    ----------
    section_out : (5,), written
    centre_hz, width_hz : float
        0 < centre < rate / 2, 0 < width < rate / 2 [Hz].
    rate_hz : float
        Of the samples [Hz].
    """
    turn = 2.0 * pi * centre_hz / rate_hz
    alpha = tan(pi * width_hz / rate_hz)
    scale = 1.0 / (1.0 + alpha)
    section_out[_S.B0] = scale
    section_out[_S.B1] = -2.0 * cos(turn) * scale
    section_out[_S.B2] = scale
    section_out[_S.A1] = -2.0 * cos(turn) * scale
    section_out[_S.A2] = (1.0 - alpha) * scale


@kernel(F8(MAT))
def delay_samples(sections):
    """Group delay of a cascade (k, 5) for slow signals [samples]."""
    delay = 0.0
    for k in range(sections.shape[0]):
        s = sections[k]
        delay += (s[_S.B1] + 2.0 * s[_S.B2]) / (s[_S.B0] + s[_S.B1] + s[_S.B2])
        delay -= (s[_S.A1] + 2.0 * s[_S.A2]) / (1.0 + s[_S.A1] + s[_S.A2])
    return delay


@kernel(VOID(MAT, MAT, MAT, VEC))
def settle(first_out, second_out, sections, values):
    """Write the memory of a cascade that has seen these values for ever.

    Parameters
    ----------
    first_out, second_out : (k, c), written
        Memory of each section and channel, transposed direct form II.
    sections : (k, 5)
        Each with a gain of 1 for constants.
    values : (c,)
    """
    for k in range(sections.shape[0]):
        s = sections[k]
        for c in range(values.shape[0]):
            second_out[k, c] = (s[_S.B2] - s[_S.A2]) * values[c]
            first_out[k, c] = (s[_S.B1] - s[_S.A1]) * values[c] + second_out[k, c]


@kernel(VOID(VEC, MAT, MAT, MAT))
def advance(values, first, second, sections):
    """Filter one sample of every channel, in place.

    Parameters
    ----------
    values : (c,), changed
    first, second : (k, c), changed
        See `settle`.
    sections : (k, 5)
    """
    for k in range(sections.shape[0]):
        s = sections[k]
        for c in range(values.shape[0]):
            x = values[c]
            y = s[_S.B0] * x + first[k, c]
            first[k, c] = s[_S.B1] * x - s[_S.A1] * y + second[k, c]
            second[k, c] = s[_S.B2] * x - s[_S.A2] * y
            values[c] = y
