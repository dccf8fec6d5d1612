"""The application that flies a scenario: a MAVSDK client that knows nothing of swingd but its published estimate.

Everything is timed by the autopilot's own clock, the stamps of its attitude: on a busy machine a simulation falls
behind the wall clock, and a manoeuvre must not change with it.
"""

import asyncio
import contextlib
import json
import math
import time
from collections.abc import AsyncIterator, Awaitable, Callable, Mapping
from functools import partial

from mavsdk.asyncio import ComponentType, Configuration, Mavsdk
from mavsdk.asyncio.plugins.action import ActionAsync
from mavsdk.asyncio.plugins.info import InfoAsync
from mavsdk.asyncio.plugins.mavlink_direct import MavlinkDirectAsync
from mavsdk.asyncio.plugins.offboard import OffboardAsync, PositionNedYaw, VelocityNedYaw
from mavsdk.asyncio.plugins.param import ParamAsync
from mavsdk.asyncio.plugins.telemetry import TelemetryAsync
from mavsdk.exceptions import MavsdkError

from swingd.link.swing_message import FIELDS, HEALTH_CODES, NAME
from swingd.model.actions import Health
from swingd.model.events import Vec3

from .plan import REST, Leg, Manoeuvre, Position, Scenario, Velocity
from .record import Flown, Step, TrialError

DISCOVERY_S = 90.0
"""Wall clock: an autopilot that compiles nothing boots in seconds, a simulation may have to compile its kernels."""
ARMING_S = 120.0
CLIMB_S = 60.0
SETTLE_S = 8.0
READY_S = 40.0
ENTER_S = 5.0
"""Hover under the setpoints before the first manoeuvre, and to turn to a new heading."""
STALL_S = 30.0
"""Wall clock without an attitude: the autopilot or the simulation has died."""
_TURN_PERIOD_S = 0.05
_ESTIMATE = tuple(
    FIELDS.index(name) for name in ("xi_rad", "zeta_rad", "correction_acc_n_mps2", "correction_acc_e_mps2", "health")
)
_READY = (HEALTH_CODES[Health.READY], HEALTH_CODES[Health.ACTIVE])

Say = Callable[[str, float], None]
"""Hears what is being done and which share of the flight is behind."""


class Clock:
    """The autopilot's, as its attitude stamps tell it."""

    def __init__(self) -> None:
        self.t_s = 0.0
        self.marks: list[tuple[float, float]] = []
        self._ticked = asyncio.Event()

    def tick(self, t_s: float) -> None:
        self.t_s = t_s
        if not self.marks or t_s - self.marks[-1][0] >= 0.1:
            self.marks.append((t_s, time.monotonic()))
        self._ticked.set()

    async def until(self, t_s: float) -> None:
        """Return when the autopilot's clock has come to `t_s`.

        Raises
        ------
        TrialError
            If it stands still.
        """
        while self.t_s < t_s:
            self._ticked.clear()
            try:
                await asyncio.wait_for(self._ticked.wait(), STALL_S)
            except TimeoutError:
                raise TrialError(f"no attitude of the autopilot for {STALL_S:g} s after {self.t_s:.1f} s") from None

    async def sleep(self, duration_s: float) -> None:
        await self.until(self.t_s + duration_s)


async def fly(
    url: str, parameters: Mapping[str, int], scenario: Scenario, manoeuvres: list[Manoeuvre], say: Say
) -> Flown:
    """Fly a scenario behind a link.

    Parameters
    ----------
    url : str
        As MAVSDK writes it.
    parameters : mapping
        Of the autopilot, to set before take-off.
    scenario : Scenario
        Its height is taken off to.
    manoeuvres : list
        Of it, those to fly.
    say : callable
        Hears about the progress.

    Raises
    ------
    TrialError
        If the vehicle is not found, does not arm, climb or enter OFFBOARD, or falls silent.
    """
    say("waiting for the autopilot", 0.0)
    try:
        async with Mavsdk(Configuration.create_with_component_type(ComponentType.GROUND_STATION)) as mavsdk:
            await mavsdk.add_any_connection(url)
            system = await mavsdk.first_autopilot(timeout_s=DISCOVERY_S)
            if system is None:
                raise TrialError(f"no autopilot on {url} within {DISCOVERY_S:g} s")
            async with _Pilot.of(system) as pilot:
                await pilot.prepare(parameters)
                await pilot.take_off(scenario.height_m, say)
                if scenario.hooked:
                    await pilot.wait_for_swingd()
                await pilot.manoeuvres(manoeuvres, say)
                return pilot.flown
    except MavsdkError as error:
        raise TrialError(f"MAVSDK: {error}") from error


class _Pilot:
    def __init__(self, system: object) -> None:
        self.clock = Clock()
        self.flown = Flown("", clock=self.clock.marks)
        self._action = ActionAsync(system)
        self._offboard = OffboardAsync(system)
        self._telemetry = TelemetryAsync(system)
        self._param = ParamAsync(system)
        self._info = InfoAsync(system)
        self._direct = MavlinkDirectAsync(system)
        self._health = 0.0

    @staticmethod
    @contextlib.asynccontextmanager
    async def of(system: object) -> "AsyncIterator[_Pilot]":
        pilot = _Pilot(system)
        watching = [asyncio.create_task(watch()) for watch in (pilot._watch_clock, pilot._watch_estimate)]
        try:
            yield pilot
        finally:
            for task in watching:
                task.cancel()
            await asyncio.gather(*watching, return_exceptions=True)
            for plugin in (pilot._action, pilot._offboard, pilot._telemetry, pilot._param, pilot._info, pilot._direct):
                plugin.destroy()

    async def _watch_clock(self) -> None:
        async for attitude in self._telemetry.subscribe_attitude_euler():
            self.clock.tick(1e-6 * attitude.timestamp_us)

    async def _watch_estimate(self) -> None:
        async for message in self._direct.subscribe_message("DEBUG_FLOAT_ARRAY"):
            fields = json.loads(message.fields_json)
            if fields["name"].rstrip("\0") != NAME:
                continue
            xi, zeta, acc_n, acc_e, self._health = (fields["data"][i] for i in _ESTIMATE)
            self.flown.estimate.append((1e-6 * fields["time_usec"], xi, zeta, math.hypot(acc_n, acc_e)))

    async def _patiently(self, what: str, limit_s: float, attempt: Callable[[], Awaitable[None]]) -> None:
        """Try until it works or `limit_s` of the autopilot's time are over."""
        end_s = self.clock.t_s + limit_s
        while True:
            try:
                await attempt()
                return
            except MavsdkError as error:
                if self.clock.t_s > end_s:
                    raise TrialError(f"{what}: {error}") from error
                await self.clock.sleep(1.0)

    async def prepare(self, parameters: Mapping[str, int]) -> None:
        await self.clock.sleep(0.1)
        for name, value in parameters.items():
            await self._patiently(name, 10.0, partial(self._param.set_param_int, name, value))

    async def take_off(self, height_m: float, say: Say) -> None:
        version = await self._info.get_version()
        self.flown.version = f"{version.flight_sw_major}.{version.flight_sw_minor}.{version.flight_sw_patch}"
        say("arming", 0.0)
        # MAVSDK adds the altitude of home to that of the take-off: 0 where it is not known yet.
        await self._home()
        await self._action.set_takeoff_altitude(height_m)
        await self._patiently("arming and take-off", ARMING_S, self._arm_and_take_off)
        say("take-off", 0.0)
        ground_m = (await self._telemetry.position_velocity_ned()).position.down_m
        end_s = self.clock.t_s + CLIMB_S
        while ground_m - (await self._telemetry.position_velocity_ned()).position.down_m < height_m - 0.4:
            if self.clock.t_s > end_s:
                raise TrialError(f"not at {height_m:g} m within {CLIMB_S:g} s of take-off")
            await self.clock.sleep(0.1)
        await self.clock.sleep(SETTLE_S)

    async def wait_for_swingd(self) -> None:
        """Return when its estimate is ready."""
        end_s = self.clock.t_s + READY_S
        while self._health not in _READY:
            if self.clock.t_s > end_s:
                raise TrialError(f"swingd not ready within {READY_S:g} s of hover, health code {self._health:g}")
            await self.clock.sleep(0.1)

    async def _home(self) -> None:
        """Return when the autopilot has told its home."""
        try:
            async with asyncio.timeout(ARMING_S):
                async for _ in self._telemetry.subscribe_home():
                    return
        except TimeoutError:
            raise TrialError(f"the autopilot told no home within {ARMING_S:g} s") from None

    async def _arm_and_take_off(self) -> None:
        """In one go: a Copter arms before it knows where it is, takes off only then, and disarms meanwhile."""
        await self._action.arm()
        await self._action.takeoff()

    async def manoeuvres(self, manoeuvres: list[Manoeuvre], say: Say) -> None:
        total_s = sum(ENTER_S + manoeuvre.duration_s for manoeuvre in manoeuvres)
        done_s = 0.0
        for number, manoeuvre in enumerate(manoeuvres):
            say(manoeuvre.name, done_s / total_s)
            await self._velocity(REST, manoeuvre.yaw_deg)
            if number == 0:
                await self._patiently("entering OFFBOARD", 5.0, self._offboard.start)
            await self.clock.sleep(ENTER_S)
            await self._fly(manoeuvre)
            done_s += ENTER_S + manoeuvre.duration_s
        say("done", 1.0)

    async def _fly(self, manoeuvre: Manoeuvre) -> None:
        origin = (await self._telemetry.position_velocity_ned()).position
        pieces: list[tuple[float, list[tuple[float, float, float, float]]]] = []
        due_s = self.clock.t_s
        for leg in manoeuvre.legs:
            pieces.append((self.clock.t_s, []))
            due_s += leg.duration_s
            if isinstance(leg.setpoint, Position):
                north, east, down = leg.setpoint.offset_ned_m
                await self._offboard.set_position_ned(
                    PositionNedYaw(
                        origin.north_m + north, origin.east_m + east, origin.down_m + down, manoeuvre.yaw_deg
                    )
                )
            else:
                await self._stream(leg, leg.setpoint, manoeuvre.yaw_deg, due_s, pieces[-1][1])
            await self.clock.until(due_s)
        note = self.flown.steps.append
        ends_s = [*(t_s for t_s, _ in pieces[1:]), self.clock.t_s]
        if manoeuvre.each:
            for leg, (t_s, velocity), end_s in zip(manoeuvre.legs, pieces, ends_s, strict=True):
                note(Step(manoeuvre.name, leg.name, manoeuvre.yaw_deg, t_s, t_s, end_s, velocity))
        else:
            commanded = [row for _, velocity in pieces for row in velocity]
            first_s, last_s = pieces[0][0], pieces[-1][0]
            note(Step(manoeuvre.name, "", manoeuvre.yaw_deg, first_s, last_s, ends_s[-1], commanded))

    async def _stream(
        self,
        leg: Leg,
        setpoint: Velocity,
        yaw_deg: float,
        end_s: float,
        commanded: list[tuple[float, float, float, float]],
    ) -> None:
        """Command a velocity, again and again if it turns."""
        begin_s = self.clock.t_s
        while True:
            velocity = setpoint.at(self.clock.t_s - begin_s)
            commanded.append((self.clock.t_s, *velocity))
            await self._velocity(velocity, yaw_deg)
            if setpoint.turn_radps == 0.0 or self.clock.t_s + _TURN_PERIOD_S > end_s:
                return
            await self.clock.sleep(_TURN_PERIOD_S)

    async def _velocity(self, ned_mps: Vec3, yaw_deg: float) -> None:
        await self._offboard.set_velocity_ned(VelocityNedYaw(*ned_mps, yaw_deg))
