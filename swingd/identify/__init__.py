"""Load mass, cable length and damping from a flight, with the intervals that the flight allows."""

from swingd.identify.identification import Identification, Known, Quantity, identify
from swingd.identify.segments import FlightRecord

__all__ = ["FlightRecord", "Identification", "Known", "Quantity", "identify"]
