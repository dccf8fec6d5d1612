"""An offboard application as its author wrote it, for MAVSDK and an autopilot; it knows nothing of swingd.

    python offboard_application.py udpin://0.0.0.0:14540

Prints one JSON object per stage of the flight.
"""

import asyncio
import json
import sys
from math import hypot
from typing import Any

from mavsdk.asyncio import ComponentType, Configuration, Mavsdk
from mavsdk.asyncio.plugins.action import ActionAsync
from mavsdk.asyncio.plugins.mission import MissionAsync, MissionItem, MissionPlan
from mavsdk.asyncio.plugins.offboard import OffboardAsync, PositionNedYaw, VelocityNedYaw
from mavsdk.asyncio.plugins.param import ParamAsync
from mavsdk.asyncio.plugins.telemetry import LandedState, TelemetryAsync

HEIGHT_M = 4.0
NAN = float("nan")


def say(stage: str, **what: Any) -> None:
    print(json.dumps({"stage": stage, **what}), flush=True)


def mission() -> MissionPlan:
    action = MissionItem.CameraAction.NONE
    vehicle = MissionItem.VehicleAction.NONE
    return MissionPlan(
        [
            MissionItem(47.3977 + 1e-4 * i, 8.5456, 10.0, 3.0, True, NAN, NAN, action, NAN, NAN, 1.0, NAN, NAN, vehicle)
            for i in range(4)
        ]
    )


async def at_height(telemetry: TelemetryAsync, height_m: float) -> None:
    while abs((await telemetry.position()).relative_altitude_m - height_m) > 0.3:
        await asyncio.sleep(0.1)


async def fly(url: str) -> None:
    async with Mavsdk(Configuration.create_with_component_type(ComponentType.GROUND_STATION)) as mavsdk:
        await mavsdk.add_any_connection(url)
        system = await mavsdk.first_autopilot(timeout_s=20.0)
        assert system is not None
        say("discovered", system_id=await system.get_system_id())
        action, offboard, telemetry = ActionAsync(system), OffboardAsync(system), TelemetryAsync(system)
        param, missions = ParamAsync(system), MissionAsync(system)
        try:
            await param.set_param_int("COM_OBL_RC_ACT", 5)
            await param.set_param_float("MIS_TAKEOFF_ALT", HEIGHT_M)
            say(
                "parameters",
                loss_action=await param.get_param_int("COM_OBL_RC_ACT"),
                loss_s=await param.get_param_float("COM_OF_LOSS_T"),
            )
            plan = mission()
            await missions.upload_mission(plan)
            say("mission", items=len((await missions.download_mission()).mission_items))
            await action.arm()
            await action.takeoff()
            await at_height(telemetry, HEIGHT_M)
            say("in the air", state=(await telemetry.landed_state()).name)
            await asyncio.sleep(5.0)
            await offboard.set_velocity_ned(VelocityNedYaw(0.0, 0.0, 0.0, 0.0))
            await offboard.start()
            await asyncio.sleep(4.0)
            say("step")
            await offboard.set_velocity_ned(VelocityNedYaw(3.0, 0.0, 0.0, 0.0))
            await asyncio.sleep(12.5)
            flown = await telemetry.position_velocity_ned()
            say("velocity", north_mps=flown.velocity.north_m_s, east_mps=flown.velocity.east_m_s)
            goal = flown.position.north_m + 8.0, flown.position.east_m
            await offboard.set_position_ned(PositionNedYaw(*goal, -HEIGHT_M, 0.0))
            await asyncio.sleep(9.0)
            there = (await telemetry.position_velocity_ned()).position
            say("position", miss_m=hypot(there.north_m - goal[0], there.east_m - goal[1]))
            await offboard.stop()
            await action.land()
            while await telemetry.landed_state() is not LandedState.ON_GROUND:
                await asyncio.sleep(0.2)
            say("landed")
        finally:
            for plugin in (action, offboard, telemetry, param, missions):
                plugin.destroy()


if __name__ == "__main__":
    asyncio.run(fly(sys.argv[1]))
