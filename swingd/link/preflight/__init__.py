"""What an autopilot's own parameters mean to a vehicle with a slung load: read, judged, and explained in words."""

from swingd.link.preflight.advice import Advice, AdviceSeverity, advise, parameters_of, voltage_compensated
from swingd.link.preflight.budget import LinkBudget, carrier, link_budget
from swingd.link.preflight.reader import ParameterReader

__all__ = [
    "Advice",
    "AdviceSeverity",
    "LinkBudget",
    "ParameterReader",
    "advise",
    "carrier",
    "link_budget",
    "parameters_of",
    "voltage_compensated",
]
