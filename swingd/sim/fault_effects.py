"""What each fault does: to the simulated world, to what the autopilot measures and says, and to the link.

A fault is a fault: none of these is known to the autopilot's loops or to swingd otherwise than by what it does.
"""

from collections import deque
from enum import Enum
from math import cos, inf, nan, pi, sin
from typing import TYPE_CHECKING, Any

import numpy as np
from pymavlink.dialects.v20 import common as mavlink

from swingd.model.ground_parameters import BY_NAME
from swingd.sim.plant import DT_S, Quaternion, Rotors
from swingd.sim.sensors import Sensed

if TYPE_CHECKING:
    from swingd.sim.peer import SimulatedAutopilot

REORDERED_MAX_S = 0.06
"""By which a frame that is overtaken is late."""
NOISE_MAX_BYTES = 2
"""Between two frames of a corrupted link."""
GUST_S = (2.0, 5.0)
"""Shortest and longest gust."""
RIVAL_PERIOD_S = 0.05
_COMPANION = (1, 191)
_USEC32 = 2**32
_NOT_NUMBERS = (nan, inf, -inf)


class Direction(Enum):
    """Of a frame on the autopilot's link."""

    TO_COMPANION = "to companion"
    TO_AUTOPILOT = "to autopilot"


class Effect:
    """One fault at work; what a hook is given stays as it is unless a fault overrides the hook.

    Parameters
    ----------
    strength : float
        In the unit that the fault's kind declares.
    random : Generator
        Of this fault alone.
    """

    on_link = False
    """Whether `carry` does anything."""

    def __init__(self, strength: float, random: np.random.Generator) -> None:
        self.strength = strength
        self.random = random

    def begin(self, peer: "SimulatedAutopilot") -> None:
        """The fault begins."""

    def step(self, peer: "SimulatedAutopilot") -> None:
        """It lasts for one more step of `DT_S`."""

    def end(self, peer: "SimulatedAutopilot") -> None:
        """It ends."""

    def sense(self, sensed: Sensed) -> None:
        """Change what was just measured, in place."""

    def drive(self, rotors: Rotors) -> Rotors:
        """Return what the motors do of what is commanded."""
        return rotors

    def say(self, message: Any) -> None:
        """Change a message of the autopilot before it is packed, in place."""

    def carry(self, direction: Direction, t_s: float, frames: list[bytes]) -> list[bytes]:
        """Take the frames that enter the link in one step; return what leaves it."""
        return frames

    def rest(self, direction: Direction) -> list[bytes]:
        """Return what still waits on the link at the end."""
        return []


# ------------------------------------------------------------------ the link


class _LinkEffect(Effect):
    on_link = True


class Loss(_LinkEffect):
    """Frames are lost, each on its own."""

    def carry(self, direction: Direction, t_s: float, frames: list[bytes]) -> list[bytes]:
        """Lose some."""
        return [raw for raw in frames if self.random.random() >= self.strength]


class Gap(_LinkEffect):
    """Nothing passes."""

    def carry(self, direction: Direction, t_s: float, frames: list[bytes]) -> list[bytes]:
        """Lose all."""
        return []


class Duplicate(_LinkEffect):
    """Frames come twice."""

    def carry(self, direction: Direction, t_s: float, frames: list[bytes]) -> list[bytes]:
        """Repeat some."""
        return [raw for raw in frames for _ in range(2 if self.random.random() < self.strength else 1)]


class Corrupt(_LinkEffect):
    """One byte of a frame is another, and noise stands between the frames."""

    def carry(self, direction: Direction, t_s: float, frames: list[bytes]) -> list[bytes]:
        """Spoil some."""
        out: list[bytes] = []
        for raw in frames:
            if self.random.random() < self.strength:
                spoiled = bytearray(raw)
                spoiled[self.random.integers(len(raw))] ^= 1 + int(self.random.integers(255))
                out += [self.random.bytes(int(self.random.integers(NOISE_MAX_BYTES + 1))), bytes(spoiled)]
            else:
                out.append(raw)
        return out


class _Queued(_LinkEffect):
    """Frames wait, each until its time."""

    def __init__(self, strength: float, random: np.random.Generator) -> None:
        super().__init__(strength, random)
        self._waiting: dict[Direction, deque[tuple[float, bytes]]] = {direction: deque() for direction in Direction}

    def carry(self, direction: Direction, t_s: float, frames: list[bytes]) -> list[bytes]:
        """Let those wait that enter; return those whose time has come."""
        waiting = self._waiting[direction]
        waiting.extend((self.due_s(direction, t_s), raw) for raw in frames)
        due: list[bytes] = []
        while waiting and waiting[0][0] <= t_s + 0.5 * DT_S:
            due.append(waiting.popleft()[1])
        return due

    def due_s(self, direction: Direction, t_s: float) -> float:
        """When a frame that enters now leaves, not before those that entered earlier."""
        raise NotImplementedError

    def rest(self, direction: Direction) -> list[bytes]:
        """Return what still waits."""
        waiting = self._waiting[direction]
        rest = [raw for _, raw in waiting]
        waiting.clear()
        return rest


class Delay(_Queued):
    """Every frame is late by the same time."""

    def due_s(self, direction: Direction, t_s: float) -> float:
        """After a constant time."""
        return t_s + self.strength


class Jitter(_Queued):
    """The link stalls again and again and then delivers at once what has piled up, in order."""

    def __init__(self, strength: float, random: np.random.Generator) -> None:
        super().__init__(strength, random)
        self._opens_s = dict.fromkeys(Direction, 0.0)
        self._stalls_s = dict.fromkeys(Direction, 0.0)

    def due_s(self, direction: Direction, t_s: float) -> float:
        """When the stall ends."""
        if t_s >= self._stalls_s[direction]:
            # A new stall, and after it a time of the same kind without one.
            self._opens_s[direction] = t_s + self.random.uniform(0.0, self.strength)
            self._stalls_s[direction] = self._opens_s[direction] + self.random.uniform(0.0, self.strength)
        return max(t_s, self._opens_s[direction])


class Reorder(_Queued):
    """Some frames are overtaken by later ones."""

    def carry(self, direction: Direction, t_s: float, frames: list[bytes]) -> list[bytes]:
        """Hold some back for up to `REORDERED_MAX_S`."""
        waiting = self._waiting[direction]
        for raw in frames:
            late = self.random.random() < self.strength
            waiting.append((t_s + (self.random.uniform(0.0, REORDERED_MAX_S) if late else 0.0), raw))
        due = sorted((held for held in waiting if held[0] <= t_s), key=lambda held: held[0])
        self._waiting[direction] = deque(held for held in waiting if held[0] > t_s)
        return [raw for _, raw in due]


# ------------------------------------------------- what the autopilot says


class NotANumber(Effect):
    """One real number of a message is NaN or infinite."""

    def say(self, message: Any) -> None:
        """Spoil one field."""
        kind = type(message)
        reals = [name for name, of in zip(kind.fieldnames, kind.fieldtypes, strict=True) if of in ("float", "double")]
        if not reals or self.random.random() >= self.strength:
            return
        name = reals[self.random.integers(len(reals))]
        wrong = _NOT_NUMBERS[self.random.integers(len(_NOT_NUMBERS))]
        value = getattr(message, name)
        if isinstance(value, (list, tuple)):
            values = list(value)
            values[self.random.integers(len(values))] = wrong
            setattr(message, name, values)
        else:
            setattr(message, name, wrong)


class Clock(Effect):
    """The autopilot's clock steps, and steps back at the end."""

    def say(self, message: Any) -> None:
        """Shift the stamps."""
        if hasattr(message, "time_boot_ms"):
            message.time_boot_ms = (message.time_boot_ms + round(1e3 * self.strength)) % _USEC32
        if hasattr(message, "time_usec"):
            shifted_us = message.time_usec + round(1e6 * self.strength)
            short = message.get_msgId() == mavlink.MAVLINK_MSG_ID_SERVO_OUTPUT_RAW
            message.time_usec = shifted_us % _USEC32 if short else max(0, shifted_us)
        if message.get_msgId() == mavlink.MAVLINK_MSG_ID_TIMESYNC:
            message.tc1 += round(1e9 * self.strength)


class Voltage(Effect):
    """The reported voltage is a constant."""

    def begin(self, peer: "SimulatedAutopilot") -> None:
        """Claim it."""
        peer.battery.claimed_v = self.strength

    def end(self, peer: "SimulatedAutopilot") -> None:
        """Tell the truth."""
        peer.battery.claimed_v = None


class VoltageFrozen(Voltage):
    """The reported voltage stays what it was."""

    def begin(self, peer: "SimulatedAutopilot") -> None:
        """Claim the present one."""
        peer.battery.claimed_v = peer.battery.reported_v


class Sag(Effect):
    """The pack gives less voltage than it reports."""

    def begin(self, peer: "SimulatedAutopilot") -> None:
        """Let it sag."""
        peer.battery.sag += self.strength

    def end(self, peer: "SimulatedAutopilot") -> None:
        """Let it recover."""
        peer.battery.sag -= self.strength


# ----------------------------------------------- what the autopilot measures


class ImuFrozen(Effect):
    """The published inertial sample is always the same, with new stamps; the loops fly by another sensor."""

    _frozen: tuple[Any, Any] | None = None

    def sense(self, sensed: Sensed) -> None:
        """Publish the first sample again."""
        if self._frozen is None:
            self._frozen = sensed.imu_acc_frd_mps2, sensed.imu_gyro_frd_radps
        sensed.imu_acc_frd_mps2, sensed.imu_gyro_frd_radps = self._frozen


class AccBias(Effect):
    """The published acceleration is wrong by a constant, forward and to the right; the autopilot does not learn it."""

    def sense(self, sensed: Sensed) -> None:
        """Add it."""
        forward, right, down = sensed.imu_acc_frd_mps2
        sensed.imu_acc_frd_mps2 = (forward + self.strength, right + self.strength, down)


class Vibrate(Effect):
    """The rotors shake the accelerometer."""

    def begin(self, peer: "SimulatedAutopilot") -> None:
        """Unbalance them."""
        peer.vibration.amplitude_mps2 += self.strength

    def end(self, peer: "SimulatedAutopilot") -> None:
        """Balance them."""
        peer.vibration.amplitude_mps2 -= self.strength


class _Turned(Effect):
    """The estimated attitude is turned, by a step at the beginning and back at the end; the gyro shows neither."""

    axis_ned = (0.0, 0.0, 0.0)

    def sense(self, sensed: Sensed) -> None:
        """Turn it about an axis of ned."""
        s = sin(0.5 * self.strength)
        turn = (cos(0.5 * self.strength), s * self.axis_ned[0], s * self.axis_ned[1], s * self.axis_ned[2])
        sensed.ned_from_frd = _product(turn, sensed.ned_from_frd)


class AttitudeReset(_Turned):
    """Of roll and pitch."""

    axis_ned = (0.5**0.5, 0.5**0.5, 0.0)


class YawJump(_Turned):
    """Of the heading."""

    axis_ned = (0.0, 0.0, 1.0)


# ------------------------------------------------------------------ the world


class Reboot(Effect):
    """The autopilot starts anew, disarmed."""

    def begin(self, peer: "SimulatedAutopilot") -> None:
        """Do it."""
        peer.reboot()


class Gust(Effect):
    """Gusts of the 1-cosine form, one after the other, each from a direction of its own."""

    def __init__(self, strength: float, random: np.random.Generator) -> None:
        super().__init__(strength, random)
        self._begin_s = self._long_s = 0.0
        self._north = self._east = 0.0

    def step(self, peer: "SimulatedAutopilot") -> None:
        """Blow."""
        if peer.t_s >= self._begin_s + self._long_s:
            self._begin_s, self._long_s = peer.t_s, self.random.uniform(*GUST_S)
            towards = self.random.uniform(0.0, 2.0 * pi)
            self._north, self._east = cos(towards), sin(towards)
        speed = 0.5 * self.strength * (1.0 - cos(2.0 * pi * (peer.t_s - self._begin_s) / self._long_s))
        peer.plant.set_squall((speed * self._north, speed * self._east, 0.0))

    def end(self, peer: "SimulatedAutopilot") -> None:
        """Calm down."""
        peer.plant.set_squall((0.0, 0.0, 0.0))


class Jerk(Effect):
    """The load is thrown up, and falls back into its cable."""

    def begin(self, peer: "SimulatedAutopilot") -> None:
        """Throw it."""
        peer.plant.kick((0.0, 0.0, -self.strength))


class Power(Effect):
    """The motors turn slower than they are told to."""

    def drive(self, rotors: Rotors) -> Rotors:
        """Take a share."""
        kept = 1.0 - self.strength
        a, b, c, d = rotors
        return (kept * a, kept * b, kept * c, kept * d)


# ------------------------------------------------------------- who else talks


class Rival(Effect):
    """A second companion behind the autopilot asks it for a velocity to north, twenty times a second."""

    _due_s = 0.0

    def step(self, peer: "SimulatedAutopilot") -> None:
        """Ask when it is time."""
        if peer.t_s < self._due_s:
            return
        self._due_s = peer.t_s + RIVAL_PERIOD_S
        mask = 0b0000_1101_1100_0111
        peer.say_beside(
            mavlink.MAVLink_set_position_target_local_ned_message(
                0, 1, 1, 1, mask, 0.0, 0.0, 0.0, self.strength, *(0.0,) * 7
            )
        )


class Flood(Effect):
    """A ground station behind the autopilot asks swingd for parameters, and sets some to what they cannot be."""

    def __init__(self, strength: float, random: np.random.Generator) -> None:
        super().__init__(strength, random)
        self._owed = 0.0
        self._names = list(BY_NAME)

    def step(self, peer: "SimulatedAutopilot") -> None:
        """Send what is due."""
        self._owed += self.strength * DT_S
        while self._owed >= 1.0:
            self._owed -= 1.0
            peer.send_to_companion(self._question())

    def _question(self) -> Any:
        name = self._names[self.random.integers(len(self._names))].encode()
        match self.random.integers(4):
            case 0:
                return mavlink.MAVLink_param_request_list_message(*_COMPANION)
            case 1:
                return mavlink.MAVLink_param_set_message(*_COMPANION, name, nan, mavlink.MAV_PARAM_TYPE_REAL32)
            case 2:
                return mavlink.MAVLink_param_set_message(*_COMPANION, b"NO_SUCH_NAME", 1.0, 9)
            case _:
                return mavlink.MAVLink_param_request_read_message(*_COMPANION, name, -1)


def _product(a: Quaternion, b: Quaternion) -> Quaternion:
    """Rotation ``b``, then ``a``."""
    aw, ax, ay, az = a
    bw, bx, by, bz = b
    return (
        aw * bw - ax * bx - ay * by - az * bz,
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
    )
