"""Estimators of the swing, each a file of its own over the kernel of the same name, chosen by name."""

from swingd.estimation.base import SwingEstimator
from swingd.estimation.fgdf import Fgdf
from swingd.estimation.pendulum import Pendulum
from swingd.estimation.swing_ekf import SwingEkf
from swingd.model.parameters import Parameters

__all__ = ["Fgdf", "Pendulum", "SwingEkf", "SwingEstimator", "make_estimator"]


def make_estimator(parameters: Parameters) -> SwingEstimator:
    """Build the estimator that ``estimator.name`` asks for."""
    if parameters.estimator.name == "pendulum":
        return Pendulum(parameters)
    if parameters.estimator.name == "fgdf":
        return Fgdf(parameters)
    return SwingEkf(parameters)
