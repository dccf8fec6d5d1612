"""Feed-forward of one stream of setpoints: shaped, planned, and blended in by the correction's own fade."""

from dataclasses import replace

from swingd.control.base import Vec2
from swingd.control.nominal import NominalMotion
from swingd.model.events import AutopilotKind, SetpointUse, Vec3
from swingd.model.parameters import Parameters, ShaperName
from swingd.pipeline.merge import ACC_XY, POS_XY, VEL_XY, Reference
from swingd.pipeline.shaping import Shaper, Target

CARRIED_MAX_S = 0.25
"""A position that is given with its velocity moves on with it for this long after it came."""
_ZERO: Vec2 = (0.0, 0.0)


class FeedForward:
    """Turns what is asked for into a motion that excites no swing, and says how the load will swing meanwhile.

    Parameters
    ----------
    parameters : Parameters
        Limits, masses, cable, and the autopilot's loops.
    """

    def __init__(self, parameters: Parameters) -> None:
        self._parameters = parameters
        self._name = ShaperName.NONE
        self._shaper = Shaper(parameters, self._name)
        self._nominal = NominalMotion(parameters)
        self._active = False

    def configure(self, parameters: Parameters) -> None:
        """Take other parameters; the motion goes on from where it is."""
        self._parameters = parameters
        self._shaper.configure(parameters, self._name)
        self._nominal.configure(parameters)

    def drop(self) -> None:
        """Nothing is shaped any more; the next motion begins where the setpoints then are."""
        self._active = False

    @property
    def swing(self) -> tuple[Vec2, Vec2]:
        """Horizontal part of the cable's unit vector and its derivative as planned, north and east [1, 1/s]."""
        if not self._active:
            return _ZERO, _ZERO
        return self._nominal.direction, self._nominal.direction_rate_per_s

    def update(
        self,
        reference: Reference,
        name: ShaperName,
        *,
        kind: AutopilotKind,
        fade: float,
        dt_s: float,
        age_s: float = 0.0,
        place_m: Vec2 | None = None,
    ) -> Reference:
        """Shape the horizontal part of a reference.

        Parameters
        ----------
        reference : Reference
            What is asked for.
        name : ShaperName
            ``NONE`` returns the reference as it is, as does one that asks for accelerations alone.
        kind : AutopilotKind
            Whose groups of components are to be kept whole.
        fade : float
            0 (the reference as it is) to 1 (the shaped one).
        dt_s : float
            Since the last call, > 0 [s].
        age_s : float
            Of the reference [s].
        place_m : (2,) or None
            Where the vehicle is, north and east [m].
        """
        target = _target(reference, age_s)
        if fade <= 0.0 or name is ShaperName.NONE or target is None:
            self.drop()
            return reference
        if name is not self._name:
            self._name = name
            self._shaper.configure(self._parameters, name)
        if not self._active:
            self._active = True
            self._shaper.begin(target)
            self._nominal.reset(target.vel_mps)
        motion = self._shaper.update(target, dt_s, place_m)
        plan = self._nominal
        plan.step(motion.vel_mps, motion.acc_mps2, motion.jerk_mps3, dt_s, ended=self._shaper.ended)
        use, whole = reference.use, kind is AutopilotKind.ARDUPILOT
        pos = reference.pos_ned_m
        if target.pos_m is not None:
            (n, e), (lag_n, lag_e) = motion.pos_m, plan.lag_m
            pos = _blended(pos, (n - lag_n, e - lag_e), fade)
        vel = reference.vel_ned_mps if use & VEL_XY else (0.0, 0.0, reference.vel_ned_mps[2])
        acc = reference.acc_ned_mps2 if use & ACC_XY else (0.0, 0.0, reference.acc_ned_mps2[2])
        return replace(
            reference,
            use=use | (SetpointUse.VEL | SetpointUse.ACC if whole else VEL_XY | ACC_XY),
            pos_ned_m=pos,
            vel_ned_mps=_blended(_kept_down(vel, use, SetpointUse.VEL_D), plan.vel_mps, fade),
            acc_ned_mps2=_blended(_kept_down(acc, use, SetpointUse.ACC_D), plan.acc_mps2, fade),
        )


def _target(reference: Reference, age_s: float) -> Target | None:
    """What a reference asks of the horizontal motion; None where it asks for no place and no velocity."""
    use = reference.use
    pos, vel = reference.pos_ned_m[:2], reference.vel_ned_mps[:2]
    if use & VEL_XY != VEL_XY:
        vel = _ZERO
    if use & POS_XY == POS_XY:
        carried_s = min(age_s, CARRIED_MAX_S)
        place = (pos[0] + carried_s * vel[0], pos[1] + carried_s * vel[1])
        return Target(vel if age_s < CARRIED_MAX_S else _ZERO, place)
    return Target(vel) if use & VEL_XY == VEL_XY else None


def _kept_down(vector: Vec3, use: SetpointUse, down: SetpointUse) -> Vec3:
    """A component that was not asked for is zero."""
    return vector if use & down else (vector[0], vector[1], 0.0)


def _blended(asked: Vec3, shaped: Vec2, fade: float) -> Vec3:
    return asked[0] + fade * (shaped[0] - asked[0]), asked[1] + fade * (shaped[1] - asked[1]), asked[2]
