"""Small dense linear algebra for kernels: no allocation by the caller's choice, a status instead of an exception."""

import numpy as np

from swingd.core._jit import F8, I8, MAT, VEC, VOID, kernel
from swingd.core.status import Status

DOUBLINGS_MAX = 30
"""Enough for a spectral radius of 1 - 1e-8."""
DOUBLING_TOLERANCE = 1e-13
KLEINMAN_MAX = 40
"""Far from the solution each step only halves the error; near it a few steps suffice."""
KLEINMAN_TOLERANCE = 1e-11

_OK = int(Status.OK)
_NOT_CONVERGED = int(Status.NOT_CONVERGED)
_NOT_POSITIVE = int(Status.NOT_POSITIVE)


@kernel(I8(MAT, MAT))
def cholesky(L_out, A):
    """Factor a symmetric positive definite A = L L^T; only A's lower triangle is read.

    Returns
    -------
    Status
        ``NOT_POSITIVE`` if A is not positive definite or not finite; L_out is then undefined.
    """
    n = A.shape[0]
    for i in range(n):
        for j in range(i + 1):
            s = A[i, j]
            for k in range(j):
                s -= L_out[i, k] * L_out[j, k]
            if i == j:
                if not s > 0.0 or not np.isfinite(s):
                    return _NOT_POSITIVE
                L_out[i, i] = np.sqrt(s)
            else:
                L_out[i, j] = s / L_out[j, j]
        for j in range(i + 1, n):
            L_out[i, j] = 0.0
    return _OK


@kernel(VOID(VEC, MAT))
def cholesky_solve(b, L):
    """Solve L L^T x = b in place."""
    n = b.shape[0]
    for i in range(n):
        for k in range(i):
            b[i] -= L[i, k] * b[k]
        b[i] /= L[i, i]
    for i in range(n - 1, -1, -1):
        for k in range(i + 1, n):
            b[i] -= L[k, i] * b[k]
        b[i] /= L[i, i]


@kernel(I8(MAT, MAT))
def invert(A_inv_out, A):
    """Invert a general matrix by Gauss-Jordan elimination with row pivoting; A is destroyed.

    Returns
    -------
    Status
        ``NOT_CONVERGED`` if no pivot is left in a column, or one is not finite.
    """
    n = A.shape[0]
    A_inv_out[:, :] = 0.0
    for i in range(n):
        A_inv_out[i, i] = 1.0
    for column in range(n):
        pivot = column
        for row in range(column + 1, n):
            if abs(A[row, column]) > abs(A[pivot, column]):
                pivot = row
        size = abs(A[pivot, column])
        if not size > 1e-300 or not np.isfinite(size):
            return _NOT_CONVERGED
        if pivot != column:
            for k in range(n):
                A[pivot, k], A[column, k] = A[column, k], A[pivot, k]
                A_inv_out[pivot, k], A_inv_out[column, k] = A_inv_out[column, k], A_inv_out[pivot, k]
        scale = 1.0 / A[column, column]
        for k in range(n):
            A[column, k] *= scale
            A_inv_out[column, k] *= scale
        for row in range(n):
            factor = A[row, column]
            if row != column and factor != 0.0:
                for k in range(n):
                    A[row, k] -= factor * A[column, k]
                    A_inv_out[row, k] -= factor * A_inv_out[column, k]
    return _OK


@kernel(VOID(MAT, MAT, MAT))
def multiply(C_out, A, B):
    """C = A B; C_out is neither A nor B."""
    for i in range(A.shape[0]):
        for j in range(B.shape[1]):
            s = 0.0
            for k in range(A.shape[1]):
                s += A[i, k] * B[k, j]
            C_out[i, j] = s


@kernel(VOID(MAT, MAT, MAT))
def multiply_transposed(C_out, A, B):
    """C = A B^T; C_out is neither A nor B."""
    for i in range(A.shape[0]):
        for j in range(B.shape[0]):
            s = 0.0
            for k in range(A.shape[1]):
                s += A[i, k] * B[j, k]
            C_out[i, j] = s


@kernel(VOID(MAT))
def symmetrise(A):
    """Replace A by (A + A^T) / 2."""
    for i in range(A.shape[0]):
        for j in range(i):
            mean = 0.5 * (A[i, j] + A[j, i])
            A[i, j] = mean
            A[j, i] = mean


@kernel(I8(MAT, MAT, MAT, F8))
def lyapunov(X_out, A, W, shift):
    """Solve A X + X A^T + W = 0 for a stable A by Smith's doubling of the Cayley transform.

    Parameters
    ----------
    X_out : (n, n), written
    A : (n, n)
        All eigenvalues left of the imaginary axis.
    W : (n, n)
        Symmetric, positive semidefinite.
    shift : float
        Positive, near the modulus of A's eigenvalues [1/s].

    Returns
    -------
    Status
        ``NOT_CONVERGED`` if A is not stable.
    """
    n = A.shape[0]
    less = np.empty((n, n))
    for i in range(n):
        for j in range(n):
            less[i, j] = A[i, j]
        less[i, i] -= shift
    less_inv = np.empty((n, n))
    if invert(less_inv, less) != _OK:
        return _NOT_CONVERGED
    # U = (A - p)^-1 (A + p) = 1 + 2 p (A - p)^-1 and X = 2 p sum_k U^k (A - p)^-1 W (A - p)^-T U^kT
    U = np.empty((n, n))
    for i in range(n):
        for j in range(n):
            U[i, j] = 2.0 * shift * less_inv[i, j]
        U[i, i] += 1.0
    product = np.empty((n, n))
    multiply(product, less_inv, W)
    multiply_transposed(X_out, product, less_inv)
    for i in range(n):
        for j in range(n):
            X_out[i, j] *= 2.0 * shift
    term = np.empty((n, n))
    for _ in range(DOUBLINGS_MAX):
        multiply(product, U, X_out)
        multiply_transposed(term, product, U)
        settled = True
        size = 0.0
        for i in range(n):
            for j in range(n):
                X_out[i, j] += term[i, j]
                size += abs(X_out[i, j])
            # Each diagonal entry bounds its row of the semidefinite term, in its own unit.
            settled &= term[i, i] <= DOUBLING_TOLERANCE * X_out[i, i]
        if not np.isfinite(size):
            return _NOT_CONVERGED
        if settled:
            symmetrise(X_out)
            return _OK
        multiply(product, U, U)
        for i in range(n):
            for j in range(n):
                U[i, j] = product[i, j]
    return _NOT_CONVERGED


@kernel(I8(MAT, MAT, MAT, MAT, MAT, F8))
def riccati_backward_euler(P_out, P, F, S, Q, dt_s):
    """One backward Euler step of P' = F P + P F^T - P S P + Q.

    The implicit equation is the algebraic Riccati equation of A = F - 1/(2 dt) with the constant term Q + P / dt; it is
    solved by Newton-Kleinman from P.

    Parameters
    ----------
    P_out : (n, n), written
        The stabilising solution, symmetric positive definite; undefined unless ``Status.OK``.
    P, F, S, Q : (n, n)
        Covariance before the step, state Jacobian, information rate H^T R^-1 H, process noise density.
    dt_s : float
        Step [s].

    Returns
    -------
    Status
        ``NOT_CONVERGED`` if F - 1/(2 dt) - P S is not stable or the iteration does not settle: a smaller step will do.
        ``NOT_POSITIVE`` if the solution is not positive definite.
    """
    n = P.shape[0]
    half_rate = 0.5 / dt_s
    closed = np.empty((n, n))
    constant = np.empty((n, n))
    gain = np.empty((n, n))
    product = np.empty((n, n))
    current = P.copy()
    for _ in range(KLEINMAN_MAX):
        multiply(gain, current, S)
        multiply(product, gain, current)
        for i in range(n):
            for j in range(n):
                closed[i, j] = F[i, j] - gain[i, j]
                constant[i, j] = Q[i, j] + P[i, j] / dt_s + product[i, j]
            closed[i, i] -= half_rate
        if lyapunov(P_out, closed, constant, half_rate) != _OK:
            return _NOT_CONVERGED
        change = 0.0
        size = 0.0
        for i in range(n):
            for j in range(n):
                # Entries of unlike units are compared on the scale of their own diagonal.
                scale = np.sqrt(abs(P_out[i, i] * P_out[j, j]))
                change = max(change, abs(P_out[i, j] - current[i, j]) / (scale + 1e-300))
                size = max(size, abs(P_out[i, j]))
                current[i, j] = P_out[i, j]
        if not np.isfinite(size):
            return _NOT_CONVERGED
        if change <= KLEINMAN_TOLERANCE:
            if cholesky(product, P_out) != _OK:
                return _NOT_POSITIVE
            return _OK
    return _NOT_CONVERGED
