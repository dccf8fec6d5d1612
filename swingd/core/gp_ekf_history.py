"""Memory of the GP-EKF: measurements enter where their stamp places them, however late, and what followed is repeated.

Every step and every measurement is a node in order of time; a node keeps the force that acted over the interval which
it ends, what was measured, and the estimate after it. The nodes live in a ring, the oldest is forgotten first. A
measurement older than all of them comes too late.
"""

from enum import IntEnum

import numpy as np

from swingd.core._jit import F8, I8, MAT, VEC, VOID, kernel
from swingd.core.gp_ekf import NUM_STATES, GpEkfParam, correct, predict
from swingd.core.status import Status

AHEAD_MAX_S = 0.05
"""A measurement may be younger than the newest step by this much: its stamp and the step's differ by a frame."""


class Node(IntEnum):
    """Columns of a node."""

    T = 0
    """[s]"""
    FORCE = 1
    """On the vehicle over the interval that ends here, ned, 3 [N]."""
    SOURCE = 4
    """`swingd.core.gp_ekf.Source`; 0: a step."""
    VALUE = 5
    """3"""
    VAR = 8
    """3"""
    NIS = 11
    STATUS = 12
    """Of the correction."""
    X = 13
    """Estimate after this node, 10."""
    SIZE = 23


class Ring(IntEnum):
    """Offsets into what tells where the nodes lie."""

    FIRST = 0
    """Row of the oldest."""
    COUNT = 1
    STEP_T = 2
    """Time of the newest step [s]."""
    SIZE = 3


_N = Node
_R = Ring
_P = GpEkfParam
_OK = int(Status.OK)
_GATED = int(Status.GATED)
_INPUT_INVALID = int(Status.INPUT_INVALID)
_TOO_LATE = int(Status.TOO_LATE)


@kernel(VOID(MAT, MAT, VEC, F8, VEC, MAT, VEC))
def begin(nodes, covariances, ring, t_s, x, P, force):
    """Forget everything and begin with an estimate.

    Parameters
    ----------
    nodes, covariances : (n, Node.SIZE), (10 n, 10), written
        P of a node lies in ten rows.
    ring : (Ring.SIZE,), written
    t_s : float
    x, P : (10,), (10, 10)
    force : (3,)
        Taken to act until the first step tells another [N].
    """
    ring[_R.FIRST], ring[_R.COUNT], ring[_R.STEP_T] = 0.0, 1.0, t_s
    nodes[0, :] = 0.0
    nodes[0, _N.T] = t_s
    for i in range(3):
        nodes[0, _N.FORCE + i] = force[i]
    for i in range(NUM_STATES):
        nodes[0, _N.X + i] = x[i]
        for j in range(NUM_STATES):
            covariances[i, j] = P[i, j]


@kernel(I8(VEC, MAT, I8))
def _row(ring, nodes, place):
    """Row of the node at this place in time, 0 the oldest."""
    return (int(ring[_R.FIRST]) + place) % nodes.shape[0]


@kernel(VOID(VEC, MAT, MAT, MAT, VEC))
def newest(x_out, P_out, nodes, covariances, ring):
    """Give the estimate after the newest node.

    Parameters
    ----------
    x_out, P_out : (10,), (10, 10), written
    nodes, covariances, ring
        See `begin`.
    """
    row = _row(ring, nodes, int(ring[_R.COUNT]) - 1)
    for i in range(NUM_STATES):
        x_out[i] = nodes[row, _N.X + i]
        for j in range(NUM_STATES):
            P_out[i, j] = covariances[NUM_STATES * row + i, j]


@kernel(I8(MAT, MAT, VEC, I8, VEC, MAT, MAT, MAT, MAT, VEC))
def _repeat(nodes, covariances, ring, place, p, Z, weights, K_inv, inv_sq_scales, signal_var):
    """Recompute every node from this place on."""
    x, P = np.empty(NUM_STATES), np.empty((NUM_STATES, NUM_STATES))
    nis = np.empty(1)
    row = _row(ring, nodes, place - 1)
    t_s = nodes[row, _N.T]
    for i in range(NUM_STATES):
        x[i] = nodes[row, _N.X + i]
        for j in range(NUM_STATES):
            P[i, j] = covariances[NUM_STATES * row + i, j]
    for at in range(place, int(ring[_R.COUNT])):
        row = _row(ring, nodes, at)
        node = nodes[row]
        status = predict(
            x, P, node[_N.FORCE : _N.FORCE + 3], node[_N.T] - t_s, p, Z, weights, K_inv, inv_sq_scales, signal_var
        )
        if status != _OK:
            return status
        t_s = node[_N.T]
        if node[_N.SOURCE] > 0.0:
            nis[0] = 0.0
            status = correct(
                x, P, nis, int(node[_N.SOURCE]), node[_N.VALUE : _N.VALUE + 3], node[_N.VAR : _N.VAR + 3],
                p[_P.CABLE_LENGTH], p[_P.NIS_GATE],
            )  # fmt: skip
            if status != _OK and status != _GATED:
                return status
            node[_N.NIS] = nis[0]
            node[_N.STATUS] = status
        for i in range(NUM_STATES):
            node[_N.X + i] = x[i]
            for j in range(NUM_STATES):
                covariances[NUM_STATES * row + i, j] = P[i, j]
    return _OK


@kernel(I8(MAT, VEC, F8, I8))
def _make_room(nodes, ring, t_s, source):
    """Open a place for a node of this time; -1 where it is older than all.

    Nodes of the same time lie in the order of their sources, whenever they came.
    """
    count = int(ring[_R.COUNT])
    full = count == nodes.shape[0]
    if t_s < nodes[_row(ring, nodes, 1 if full else 0), _N.T]:
        return -1
    if full:
        ring[_R.FIRST] = _row(ring, nodes, 1)
        count -= 1
    place = count
    while place > 1:
        before = _row(ring, nodes, place - 1)
        if nodes[before, _N.T] < t_s or (nodes[before, _N.T] == t_s and nodes[before, _N.SOURCE] <= source):
            break
        place -= 1
    ring[_R.COUNT] = count + 1
    for at in range(count, place, -1):
        nodes[_row(ring, nodes, at), :] = nodes[_row(ring, nodes, at - 1), :]
    return place


@kernel(I8(MAT, MAT, VEC, F8, VEC, VEC, MAT, MAT, MAT, MAT, VEC))
def step(nodes, covariances, ring, t_s, force, p, Z, weights, K_inv, inv_sq_scales, signal_var):
    """Advance to a time with the force that acted since the last step.

    Parameters
    ----------
    nodes, covariances, ring
        See `begin`; not to be used any more unless ``OK`` or ``INPUT_INVALID``.
    t_s : float
        After the last step.
    force : (3,)
        On the vehicle, mean since the last step, ned [N].
    p, Z, weights, K_inv, inv_sq_scales, signal_var
        See `swingd.core.gp_ekf.predict`.

    Returns
    -------
    Status
        ``INPUT_INVALID`` where time does not advance, else as `swingd.core.gp_ekf.predict`.
    """
    if not t_s > ring[_R.STEP_T]:
        return _INPUT_INVALID
    last_s = ring[_R.STEP_T]
    ring[_R.STEP_T] = t_s
    place = _make_room(nodes, ring, t_s, 0)
    row = _row(ring, nodes, place)
    nodes[row, :] = 0.0
    nodes[row, _N.T] = t_s
    # Measurements that were ahead of this step divide its interval, and what follows it is as far unknown.
    first = place
    while first > 1 and nodes[_row(ring, nodes, first - 1), _N.T] > last_s:
        first -= 1
    for at in range(first, int(ring[_R.COUNT])):
        row = _row(ring, nodes, at)
        for i in range(3):
            nodes[row, _N.FORCE + i] = force[i]
    return _repeat(nodes, covariances, ring, first, p, Z, weights, K_inv, inv_sq_scales, signal_var)


@kernel(I8(MAT, MAT, VEC, VEC, F8, I8, VEC, VEC, VEC, MAT, MAT, MAT, MAT, VEC))
def measure(
    nodes, covariances, ring, nis_out, t_s, source, z, var, p, Z, weights, K_inv, inv_sq_scales, signal_var
):  # fmt: skip
    """Enter a measurement at its own time and repeat what came after it.

    Parameters
    ----------
    nodes, covariances, ring
        See `begin`; not to be used any more unless ``OK``, ``GATED``, ``TOO_LATE`` or ``INPUT_INVALID``.
    nis_out : (1,), written
        Normalised innovation squared, 3 degrees of freedom.
    t_s : float
        When it was taken; at most `AHEAD_MAX_S` after the newest step.
    source, z, var
        See `swingd.core.gp_ekf.correct`.
    p, Z, weights, K_inv, inv_sq_scales, signal_var
        See `swingd.core.gp_ekf.predict`.

    Returns
    -------
    Status
        ``OK``, ``GATED``; ``TOO_LATE`` where it is older than the memory, ``INPUT_INVALID`` where it is too far ahead;
        a failure of prediction or correction.
    """
    if not t_s <= ring[_R.STEP_T] + AHEAD_MAX_S:
        return _INPUT_INVALID
    place = _make_room(nodes, ring, t_s, source)
    if place < 0:
        return _TOO_LATE
    row = _row(ring, nodes, place)
    count = int(ring[_R.COUNT])
    beside = _row(ring, nodes, place + 1 if place + 1 < count else place - 1)
    nodes[row, :] = 0.0
    nodes[row, _N.T] = t_s
    nodes[row, _N.SOURCE] = source
    for i in range(3):
        nodes[row, _N.FORCE + i] = nodes[beside, _N.FORCE + i]
        nodes[row, _N.VALUE + i] = z[i]
        nodes[row, _N.VAR + i] = var[i]
    status = _repeat(nodes, covariances, ring, place, p, Z, weights, K_inv, inv_sq_scales, signal_var)
    nis_out[0] = nodes[row, _N.NIS]
    return status if status != _OK else int(nodes[row, _N.STATUS])
