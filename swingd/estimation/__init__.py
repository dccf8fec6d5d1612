"""Estimators of the swing, each a file of its own over the kernel of the same name, chosen by name."""

from collections.abc import Callable

from swingd.estimation.base import LoadEstimator, SwingEstimator
from swingd.estimation.fgdf import Fgdf
from swingd.estimation.gp_swing import GpSwing
from swingd.estimation.pendulum import Pendulum
from swingd.estimation.swing_ekf import SwingEkf
from swingd.estimation.tether_ukf import TetherUkf
from swingd.model.parameters import Parameters

__all__ = [
    "Fgdf",
    "GpSwing",
    "LoadEstimator",
    "Pendulum",
    "SwingEkf",
    "SwingEstimator",
    "TetherUkf",
    "make_estimator",
]

_BY_NAME: dict[str, Callable[[Parameters], SwingEstimator]] = {
    "swing_ekf": SwingEkf,
    "gp-ekf": GpSwing,
    "tether-ukf": TetherUkf,
    "fgdf": Fgdf,
    "pendulum": Pendulum,
}


def make_estimator(parameters: Parameters) -> SwingEstimator:
    """Build the estimator that ``estimator.name`` asks for."""
    return _BY_NAME[parameters.estimator.name](parameters)
