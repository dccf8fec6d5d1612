"""A real application: MAVSDK finds the simulated autopilot, arms it, flies it and lands it."""

import asyncio
import contextlib
from collections.abc import AsyncIterator, Callable, Iterable, Iterator
from dataclasses import replace
from math import hypot
from typing import Any

import pytest
from mavsdk.asyncio import ComponentType, Configuration, Mavsdk
from mavsdk.asyncio.plugins.action import ActionAsync
from mavsdk.asyncio.plugins.mission import MissionAsync, MissionItem, MissionPlan
from mavsdk.asyncio.plugins.mission_raw import MissionRawAsync
from mavsdk.asyncio.plugins.offboard import OffboardAsync, OffboardError, VelocityNedYaw
from mavsdk.asyncio.plugins.param import ParamAsync
from mavsdk.asyncio.plugins.telemetry import LandedState, TelemetryAsync
from ports import udp_port
from pymavlink.dialects.v20 import common as mavlink

from swingd.link.codec import Codec
from swingd.model.parameters import Parameters, SimulatedKind
from swingd.sim.autopilot import NavState
from swingd.sim.peer import SimulatedAutopilot
from swingd.sim.run import run_simulation

pytestmark = pytest.mark.live

SPEED = 4.0
GUIDED = Codec(255, 190).encode(mavlink.MAVLink_command_long_message(1, 1, 176, 0, 1, 4, 0, 0, 0, 0, 0))
"""What a ground station sends for Copter's mode GUIDED."""


FLOWN_WITH = (ActionAsync, OffboardAsync, TelemetryAsync, ParamAsync)
Flight = tuple[SimulatedAutopilot, Any]


@pytest.fixture
async def flight(request: pytest.FixtureRequest) -> AsyncIterator[Flight]:
    """A running simulation and the system that MAVSDK finds in it."""
    port = udp_port()
    parameters = Parameters()
    parameters = replace(
        parameters,
        simulation=replace(
            parameters.simulation,
            autopilot=getattr(request, "param", SimulatedKind.PX4),
            mavlink=f"udpout://127.0.0.1:{port}",
            mavlink_bind_port=0,
            speed=SPEED,
            takeoff_altitude_m=4.0,
        ),
    )
    peer = SimulatedAutopilot(parameters)
    task = asyncio.create_task(run_simulation(parameters, peer=peer))
    try:
        async with Mavsdk(Configuration.create_with_component_type(ComponentType.GROUND_STATION)) as mavsdk:
            await mavsdk.add_any_connection(f"udpin://127.0.0.1:{port}")
            system = await mavsdk.first_autopilot(timeout_s=10.0)
            assert system is not None
            yield peer, system
    finally:
        task.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await task


@contextlib.contextmanager
def plugins(system: Any, *kinds: Callable[[Any], Any]) -> Iterator[list[Any]]:
    """MAVSDK's plugins for a system, destroyed at the end."""
    opened = [kind(system) for kind in kinds]
    try:
        yield opened
    finally:
        for plugin in opened:
            plugin.destroy()


async def _until(condition: Callable[[], bool], timeout_s: float) -> None:
    async with asyncio.timeout(timeout_s):
        while not condition():
            await asyncio.sleep(0.02)


def _described(items: Iterable[Any]) -> list[str]:
    """Mission items as texts, in which one nan equals another."""
    return [repr((item.command, item.frame, item.x, item.y, item.z)) for item in items]


async def test_mavsdk_arms_takes_off_flies_offboard_and_lands(flight: Flight) -> None:
    peer, system = flight
    assert await system.get_system_id() == 1
    with plugins(system, *FLOWN_WITH) as (action, offboard, telemetry, param):
        assert await param.get_param_int("COM_OBL_RC_ACT") == 0
        await param.set_param_int("COM_OBL_RC_ACT", 5)
        assert peer.px4["COM_OBL_RC_ACT"] == 5
        assert await param.get_param_float("COM_OF_LOSS_T") == 1.0

        await action.arm()
        assert peer.autopilot.armed
        await action.takeoff()
        await _until(lambda: peer.truth().pos_ned_m[2] < -3.5, 10.0)

        with pytest.raises(OffboardError):
            await offboard.start()
        await offboard.set_velocity_ned(VelocityNedYaw(0.0, 0.0, 0.0, 0.0))
        await offboard.start()
        await offboard.set_velocity_ned(VelocityNedYaw(2.0, -1.0, 0.0, 0.0))
        await _until(lambda: hypot(peer.truth().vel_ned_mps[0] - 2.0, peer.truth().vel_ned_mps[1] + 1.0) < 0.2, 10.0)
        seen = await telemetry.velocity_ned()
        assert seen.north_m_s == pytest.approx(2.0, abs=0.6)
        assert seen.east_m_s == pytest.approx(-1.0, abs=0.6)
        assert await telemetry.landed_state() is LandedState.IN_AIR

        await offboard.set_velocity_ned(VelocityNedYaw(0.0, 0.0, 0.0, 90.0))
        await _until(lambda: abs(peer.truth().yaw_rad - 1.571) < 0.1, 10.0)
        await offboard.stop()
        await action.land()
        await _until(lambda: not peer.autopilot.armed, 15.0)
        assert peer.truth().grounded


async def test_mavsdk_uploads_a_mission_and_downloads_it_unchanged(flight: Flight) -> None:
    peer, system = flight
    with plugins(system, MissionAsync, MissionRawAsync) as (mission, raw):
        sent = [
            MissionItem(
                latitude_deg=47.3977 + 1e-4 * i,
                longitude_deg=8.5456 - 1e-4 * i,
                relative_altitude_m=10.0 + i,
                speed_m_s=3.0 + i,
                is_fly_through=i % 2 == 0,
                acceptance_radius_m=2.0,
                yaw_deg=45.0,
                vehicle_action=MissionItem.VehicleAction.LAND if i == 5 else MissionItem.VehicleAction.NONE,
            )
            for i in range(6)
        ]
        await mission.upload_mission(MissionPlan(mission_items=sent))
        assert len(peer.missions.items()) >= len(sent)
        got = (await mission.download_mission()).mission_items
        assert len(got) == len(sent)
        for a, b in zip(sent, got, strict=True):
            assert (b.latitude_deg, b.longitude_deg) == pytest.approx((a.latitude_deg, a.longitude_deg), abs=1e-7)
            assert b.relative_altitude_m == a.relative_altitude_m
            assert b.speed_m_s == a.speed_m_s
            assert b.is_fly_through is a.is_fly_through
            assert b.vehicle_action == a.vehicle_action
        stored = _described(peer.missions.items())
        items = await raw.download_mission()
        assert _described(items) == stored
        await raw.upload_mission(items)
        assert _described(peer.missions.items()) == stored
        await mission.clear_mission()
        assert peer.missions.items() == ()


@pytest.mark.parametrize("flight", [SimulatedKind.ARDUPILOT], indirect=True)
async def test_mavsdk_flies_copter_in_guided(flight: Flight) -> None:
    peer, system = flight
    with plugins(system, *FLOWN_WITH) as (action, offboard, telemetry, param):
        assert await param.get_param_float("GUID_TIMEOUT") == 3.0
        await param.set_param_int("RTL_ALT", 2000)
        assert peer.parameters["RTL_ALT"] == 2000
        await telemetry.set_rate_position_velocity_ned(20.0)
        await action.set_takeoff_altitude(4.0)
        peer.receive(GUIDED)
        await action.arm()
        await action.takeoff()
        await _until(lambda: peer.truth().pos_ned_m[2] < -3.5, 10.0)
        await offboard.set_velocity_ned(VelocityNedYaw(0.0, 0.0, 0.0, 0.0))
        await offboard.start()
        await offboard.set_velocity_ned(VelocityNedYaw(2.0, -1.0, 0.0, 0.0))
        await _until(lambda: hypot(peer.truth().vel_ned_mps[0] - 2.0, peer.truth().vel_ned_mps[1] + 1.0) < 0.2, 10.0)
        async with asyncio.timeout(10.0):
            while (await telemetry.velocity_ned()).north_m_s < 1.4:
                await asyncio.sleep(0.05)
        assert peer.autopilot.nav_state is NavState.GUIDED
        await action.land()
        await _until(lambda: not peer.autopilot.armed, 20.0)
        assert peer.truth().grounded
