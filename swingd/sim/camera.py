"""A companion's camera that looks down from the vehicle, sees a fiducial on the load and tells where it is."""

from collections import deque
from math import atan2, cos, hypot, inf

import numpy as np
from pymavlink.dialects.v20 import common as mavlink

from swingd.core.slung_plant import PlantState
from swingd.model.events import Vec3
from swingd.model.parameters import Simulation
from swingd.sim.plant import DT_S, rotation_matrix

EPOCH_US = 1_700_000_000_000_000
"""Unix time of the start by the camera's clock, which no reboot of the autopilot sets back."""

_STREAM = 6
"""Which of the simulation's random streams is the camera's."""
_STEP_US = round(DT_S * 1e6)
_NO_ROTATION = (1.0, 0.0, 0.0, 0.0)


class Camera:
    """Takes pictures of the load, and says later what each has shown.

    Parameters
    ----------
    simulation : Simulation
        The group's keys ``camera_*``, ``camera_hz`` above 0; ``seed`` for noise and dropouts.

    Notes
    -----
    It sits at the vehicle's centre of gravity and looks along the body's down axis. Whether the load is seen is a
    matter of the truth; noise is added to what is told, of equal deviation on each axis. Between two dropouts an
    exponential time passes, such that they take their share of it. Picture number k is taken with the first step that
    ends k periods after the start or later, so a rate that does not divide 250 Hz is kept on average.
    """

    def __init__(self, simulation: Simulation) -> None:
        self._hz = simulation.camera_hz
        self._delay_steps = round(simulation.camera_delay_s / DT_S)
        self._noise_m = simulation.camera_noise_m
        self._noise_share = simulation.camera_noise_share
        self._cos_half_angle = cos(simulation.camera_half_angle_rad)
        self._noise, self._dropouts = np.random.default_rng((simulation.seed, _STREAM)).spawn(2)
        share = simulation.camera_dropout_share
        self._dropout_s = simulation.camera_dropout_s
        self._between_s = self._dropout_s * (1.0 / share - 1.0) if share > 0.0 else inf
        self._blind_from_s = float(self._dropouts.exponential(self._between_s))
        self._pictures = 1
        self._waiting: deque[tuple[int, mavlink.MAVLink_landing_target_message]] = deque()

    def step(self, steps: int, state: list[float], *, attached: bool) -> mavlink.MAVLink_landing_target_message | None:
        """Take a picture if it is time to; return the message that is ready, if one is.

        Parameters
        ----------
        steps : int
            Steps of `DT_S` since the start; to be called with each.
        state : list of float
            Of the plant after this step, by `PlantState`.
        attached : bool
            Whether the load hangs on the cable; another one is not looked for.

        Returns
        -------
        LANDING_TARGET or None
            Load relative to the vehicle's centre of gravity, forward-right-down [m], stamped with the time of its
            picture since `EPOCH_US`. At most one is ready in a step, as pictures are further apart than that.
        """
        t_s = steps * DT_S
        if t_s * self._hz >= self._pictures - 1e-9:
            self._pictures += 1
            noise: list[float] = self._noise.standard_normal(3).tolist()  # of every picture, seen or not
            if not self._is_blind(t_s) and attached:
                self._look(steps, _relative(state), noise)
        if self._waiting and self._waiting[0][0] <= steps:
            return self._waiting.popleft()[1]
        return None

    def _is_blind(self, t_s: float) -> bool:
        """Whether a dropout lasts at ``t_s``, not before that of the last question."""
        while t_s >= self._blind_from_s + self._dropout_s:
            self._blind_from_s += self._dropout_s + float(self._dropouts.exponential(self._between_s))
        return t_s >= self._blind_from_s

    def _look(self, steps: int, rel_frd_m: Vec3, noise: list[float]) -> None:
        """Put into the queue what a picture shows, if the load is in it."""
        distance = hypot(*rel_frd_m)
        if rel_frd_m[2] <= self._cos_half_angle * distance:
            return
        std = self._noise_m + self._noise_share * distance
        forward, right, down = (true + std * normal for true, normal in zip(rel_frd_m, noise, strict=True))
        message = mavlink.MAVLink_landing_target_message(
            time_usec=EPOCH_US + steps * _STEP_US,
            target_num=0,
            frame=mavlink.MAV_FRAME_BODY_FRD,
            # In the picture, whose top is ahead: to the right, and towards the bottom.
            angle_x=atan2(right, down),
            angle_y=atan2(-forward, down),
            distance=hypot(forward, right, down),
            size_x=0.0,
            size_y=0.0,
            x=forward,
            y=right,
            z=down,
            q=_NO_ROTATION,
            type=mavlink.LANDING_TARGET_TYPE_VISION_FIDUCIAL,
            position_valid=1,
        )
        self._waiting.append((steps + self._delay_steps, message))


def _relative(state: list[float]) -> Vec3:
    """Load relative to the vehicle's centre of gravity, frd [m]."""
    x = PlantState
    north, east, down = (state[x.LOAD_POS + i] - state[x.POS + i] for i in range(3))
    w, i, j, k = state[x.QUAT : x.QUAT + 4]
    first, second, third = rotation_matrix(w, i, j, k)
    return (
        first[0] * north + second[0] * east + third[0] * down,
        first[1] * north + second[1] * east + third[1] * down,
        first[2] * north + second[2] * east + third[2] * down,
    )
