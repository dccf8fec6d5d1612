"""The vehicle that the estimators' tests fly."""

import dataclasses

import numpy as np

from swingd.core.swing_ekf import GRAVITY_MPS2
from swingd.model.parameters import Cable, Estimator, Parameters, Payload, Vehicle

M, ML, L = 1.5, 0.3, 1.5
HOVER = np.array([0.0, 0.0, -(M + ML) * GRAVITY_MPS2])
STILL = np.zeros(3)
DT_S = 0.01


def parameters(**estimator):
    return dataclasses.replace(
        Parameters(), vehicle=Vehicle(M), payload=Payload(ML), cable=Cable(L), estimator=Estimator(**estimator)
    )


EXACT = {"cable_length_std": 0.0, "payload_mass_std": 0.0}
"""Nothing of the model is to be learned."""


def faults(estimator):
    return {reason: count for reason, count in estimator.resets.items() if count}
