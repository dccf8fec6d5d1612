"""A real application: MAVSDK finds the simulated autopilot, arms it, flies it and lands it."""

import asyncio
import contextlib
import socket
from collections.abc import AsyncIterator, Callable
from dataclasses import replace
from math import hypot

import pytest
from mavsdk.asyncio import ComponentType, Configuration, Mavsdk
from mavsdk.asyncio.plugins.action import ActionAsync
from mavsdk.asyncio.plugins.offboard import OffboardAsync, OffboardError, VelocityNedYaw
from mavsdk.asyncio.plugins.param import ParamAsync
from mavsdk.asyncio.plugins.telemetry import LandedState, TelemetryAsync

from swingd.model.parameters import Parameters
from swingd.sim.peer import SimulatedAutopilot
from swingd.sim.run import run_simulation

pytestmark = pytest.mark.live

SPEED = 4.0


@pytest.fixture
async def flight() -> AsyncIterator[tuple[SimulatedAutopilot, Mavsdk]]:
    """A running simulation and a MAVSDK that listens to it."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    parameters = Parameters()
    parameters = replace(
        parameters,
        simulation=replace(
            parameters.simulation,
            mavlink=f"udpout://127.0.0.1:{port}",
            mavlink_bind_port=0,
            speed=SPEED,
            takeoff_altitude_m=4.0,
        ),
    )
    peer = SimulatedAutopilot(parameters)
    task = asyncio.create_task(run_simulation(parameters, peer=peer))
    async with Mavsdk(Configuration.create_with_component_type(ComponentType.GROUND_STATION)) as mavsdk:
        await mavsdk.add_any_connection(f"udpin://127.0.0.1:{port}")
        yield peer, mavsdk
    task.cancel()
    with contextlib.suppress(asyncio.CancelledError):
        await task


async def _until(condition: Callable[[], bool], timeout_s: float) -> None:
    async with asyncio.timeout(timeout_s):
        while not condition():
            await asyncio.sleep(0.02)


async def test_mavsdk_arms_takes_off_flies_offboard_and_lands(
    flight: tuple[SimulatedAutopilot, Mavsdk],
) -> None:
    peer, mavsdk = flight
    system = await mavsdk.first_autopilot(timeout_s=10.0)
    assert system is not None
    assert await system.get_system_id() == 1
    action, offboard, telemetry, param = (
        ActionAsync(system),
        OffboardAsync(system),
        TelemetryAsync(system),
        ParamAsync(system),
    )
    try:
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
    finally:
        for plugin in (action, offboard, telemetry, param):
            plugin.destroy()
