"""What a Gaussian process says of the cable's acceleration, (15)-(17), (20) of the GP-EKF paper.

Two independent processes, north and east, over the features z = (r, v) of (17) or, wider than the paper's, z = (r, v,
v_p) with the load's level velocity, which its drag follows; squared exponential kernel with a length scale per feature.
The training samples are bounded in number, and what the samples and hyperparameters give once,
(K + diag(noise))^-1 and its product with the targets, is computed before.
"""

from math import exp

import numpy as np

from swingd.core._jit import I8, MAT, VEC, VOID, kernel
from swingd.core.linalg import cholesky, cholesky_solve
from swingd.core.status import Status

NUM_SWING_FEATURES = 4
"""r, v, north and east."""
NUM_FEATURES = 6
"""The load's velocity too, north and east."""
NUM_OUTPUTS = 2
SAMPLES_MAX = 256

_OK = int(Status.OK)


@kernel(I8(MAT, MAT, MAT, MAT, MAT, VEC, MAT))
def prepare(weights_out, K_inv_out, Z, targets, inv_sq_scales, signal_var, noise_var):
    """Invert the samples' covariance: (K + diag(noise))^-1, and its product with the targets.

    Parameters
    ----------
    weights_out : (m, 2), written
    K_inv_out : (2 m, m), written
        One matrix after the other.
    Z : (m, k)
        Features of the samples, k 4 or 6.
    targets : (m, 2)
        [m/s^2]
    inv_sq_scales : (2, k)
        1 / length scale^2.
    signal_var : (2,)
        sigma_f^2 [(m/s^2)^2].
    noise_var : (m, 2)
        sigma_n^2 of each sample, once, on the diagonal [(m/s^2)^2].

    Returns
    -------
    Status
        ``NOT_POSITIVE`` if a covariance is not positive definite.
    """
    m = Z.shape[0]
    K = np.empty((m, m))
    L = np.empty((m, m))
    column = np.empty(m)
    for output in range(NUM_OUTPUTS):
        for i in range(m):
            for j in range(m):
                square = 0.0
                for k in range(Z.shape[1]):
                    square += inv_sq_scales[output, k] * (Z[i, k] - Z[j, k]) ** 2
                K[i, j] = signal_var[output] * exp(-0.5 * square)
            K[i, i] += noise_var[i, output]
        status = cholesky(L, K)
        if status != _OK:
            return status
        for i in range(m):
            column[:] = 0.0
            column[i] = 1.0
            cholesky_solve(column, L)
            for j in range(m):
                K_inv_out[output * m + j, i] = column[j]
        for i in range(m):
            column[i] = targets[i, output]
        cholesky_solve(column, L)
        for i in range(m):
            weights_out[i, output] = column[i]
    return _OK


@kernel(VOID(VEC, VEC, MAT, VEC, MAT, MAT, MAT, MAT, VEC))
def predict(mean_out, var_out, J_out, z, Z, weights, K_inv, inv_sq_scales, signal_var):
    """Mean, variance and the mean's Jacobian at a point; far from every sample: 0, sigma_f^2, 0.

    Parameters
    ----------
    mean_out, var_out : (2,), written
        [m/s^2], [(m/s^2)^2] without the samples' noise.
    J_out : (2, k), written
        By the features.
    z : (k,)
        r [m], v [m/s], v_p [m/s].
    Z, weights, K_inv, inv_sq_scales, signal_var
        See `prepare`.
    """
    m = Z.shape[0]
    k = np.empty(m)
    J_out[:, :] = 0.0
    for output in range(NUM_OUTPUTS):
        mean = 0.0
        for i in range(m):
            square = 0.0
            for j in range(Z.shape[1]):
                square += inv_sq_scales[output, j] * (z[j] - Z[i, j]) ** 2
            k[i] = signal_var[output] * exp(-0.5 * square)
            part = weights[i, output] * k[i]
            mean += part
            for j in range(Z.shape[1]):
                J_out[output, j] -= part * inv_sq_scales[output, j] * (z[j] - Z[i, j])
        known = 0.0
        for i in range(m):
            total = 0.5 * K_inv[output * m + i, i] * k[i]
            for j in range(i):
                total += K_inv[output * m + i, j] * k[j]
            known += 2.0 * k[i] * total
        mean_out[output] = mean
        var_out[output] = max(signal_var[output] - known, 0.0)
