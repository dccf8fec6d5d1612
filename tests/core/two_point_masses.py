"""Two point masses on a rigid massless cable, derived from their Lagrangian: the oracle of the filter's model.

Coordinates (p, xi, zeta), p the hook in a level frame with z down; the load hangs at
rho = L (sin zeta, -sin xi cos zeta, cos xi cos zeta) from it. The vehicle's mass sits at p - r, where r(t) is the hook
from the centre of gravity; with r = 0 this is the model of Drones 2023, 7, 654.
"""

from functools import cache

import numpy as np
import sympy as sp

GRAVITY = 9.80665


class TwoPointMasses:
    """Euler-Lagrange equations M(q) q'' + bias(q, q') = (w, 0, 0), w the force on the vehicle."""

    def __init__(self) -> None:
        m, ml, L, g = sp.symbols("m m_l L g")
        q = sp.Matrix(sp.symbols("p_x p_y p_z xi zeta"))
        qd = sp.Matrix(sp.symbols("v_x v_y v_z xi_rate zeta_rate"))
        # The hook moves in the body: only its second derivative is left in the equations of motion.
        r_rate = sp.Matrix(sp.symbols("r_x_rate r_y_rate r_z_rate"))
        r_rate2 = sp.Matrix(sp.symbols("r_x_rate2 r_y_rate2 r_z_rate2"))
        w = sp.Matrix(sp.symbols("w_x w_y w_z"))
        xi, zeta = q[3], q[4]
        rho = L * sp.Matrix([sp.sin(zeta), -sp.sin(xi) * sp.cos(zeta), sp.cos(xi) * sp.cos(zeta)])
        vel_load = qd[:3, 0] + rho.jacobian(q) * qd
        vel_vehicle = qd[:3, 0] - r_rate
        kinetic = m / 2 * vel_vehicle.dot(vel_vehicle) + ml / 2 * vel_load.dot(vel_load)
        lagrangian = kinetic + m * g * q[2] + ml * g * (q[2] + rho[2])
        momentum = sp.Matrix([lagrangian.diff(rate) for rate in qd])
        M = momentum.jacobian(qd)
        bias = momentum.jacobian(q) * qd + momentum.jacobian(r_rate) * r_rate2
        bias -= sp.Matrix([lagrangian.diff(coordinate) for coordinate in q])
        # The virtual displacement of the vehicle is that of p, so w belongs to the first three equations. Its velocity
        # drops out (Galileo), but only after expansion.
        right = (sp.Matrix([*w, 0, 0]) - bias).applyfunc(sp.expand)
        state = sp.Matrix([xi, zeta, qd[3], qd[4], *w])  # a disturbance is added to w
        assert not right.free_symbols & {*q[:3], *qd[:3], *r_rate}
        arguments = (tuple(state), tuple(r_rate2), m, ml, L, g)
        self._M = sp.lambdify(arguments, M, cse=True)
        self._right = sp.lambdify(arguments, right, cse=True)
        self._M_d_state = [sp.lambdify(arguments, M.diff(s), cse=True) for s in state]
        self._right_d_state = sp.lambdify(arguments, right.jacobian(state), cse=True)

    def accelerations(self, x, u, m, ml, L, r_rate2=(0.0, 0.0, 0.0)):
        """q'' of hook and angles, (5,)."""
        arguments = (self._state(x, u), r_rate2, m, ml, L, GRAVITY)
        return np.linalg.solve(self._M(*arguments), self._right(*arguments)[:, 0])

    def dynamics(self, x, u, m, ml, L):
        """f, (7,)."""
        return np.concatenate([x[2:4], self.accelerations(x, u, m, ml, L)[3:], np.zeros(3)])

    def observation(self, x, u, m, ml, L):
        """h, (3,)."""
        return self.accelerations(x, u, m, ml, L)[:3]

    def jacobians(self, x, u, m, ml, L):
        """F (7, 7) and H (3, 7): d(M^-1 right) = M^-1 (d right - dM q'')."""
        arguments = (self._state(x, u), (0.0, 0.0, 0.0), m, ml, L, GRAVITY)
        acceleration = self.accelerations(x, u, m, ml, L)
        columns = self._right_d_state(*arguments).astype(float)
        for column, M_d in enumerate(self._M_d_state):
            columns[:, column] -= np.asarray(M_d(*arguments), dtype=float) @ acceleration
        derivative = np.linalg.solve(self._M(*arguments), columns)
        F = np.zeros((7, 7))
        F[0, 2] = F[1, 3] = 1.0
        F[2:4] = derivative[3:]
        return F, derivative[:3]

    @staticmethod
    def _state(x, u):
        return (*x[:4], *(np.asarray(u) + x[4:7]))


@cache
def model() -> TwoPointMasses:
    return TwoPointMasses()
