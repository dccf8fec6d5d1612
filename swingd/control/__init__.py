"""Laws that answer the swing with an acceleration, chosen by name; they know no estimator and no autopilot message."""

from swingd.control.base import SwingLaw
from swingd.control.payload_law import PayloadLaw
from swingd.control.placed import PlacedLaw, design
from swingd.model.parameters import Parameters

__all__ = ["PayloadLaw", "PlacedLaw", "SwingLaw", "design", "make_law"]


def make_law(parameters: Parameters) -> SwingLaw:
    """Build the law that ``control.law`` asks for."""
    if parameters.control.law == "payload":
        return PayloadLaw(parameters)
    return PlacedLaw(parameters)
