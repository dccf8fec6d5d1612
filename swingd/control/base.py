"""The protocol of the swing laws."""

from typing import Protocol

Vec2 = tuple[float, float]


class SwingLaw(Protocol):
    """Acceleration of the vehicle that takes energy out of the swing."""

    @property
    def acts(self) -> bool:
        """Whether it asks for anything at all; a design that finds no helpful gains does not."""

    def acceleration(self, direction: Vec2, rate_per_s: Vec2) -> Vec2:
        """Answer one state of the swing.

        Parameters
        ----------
        direction : (2,)
            Horizontal part of the cable's unit vector, forward and right.
        rate_per_s : (2,)
            Its derivative in a frame that does not turn, forward and right [1/s].

        Returns
        -------
        (2,)
            Acceleration of the vehicle, forward and right [m/s^2].
        """
