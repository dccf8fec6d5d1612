"""The battery that ArduPilot's SITL reports, held to the simulation's."""

from pymavlink.dialects.v20 import common as mavlink

from swingd.sim.hil.battery import ReportedBattery

MAVLINK_PORT = 5763
"""TCP port of ArduPilot's SERIAL2 on instance 0; instance N has this + 10 N."""

_OFF_V = 0.03
_OFF_REPORTS = 5


class ArdupilotBattery(ReportedBattery):
    """Follow the voltage that one ArduPilot reports, and correct it where it is another.

    Notes
    -----
    Newer ArduPilots take the voltage from their simulator's answers. Others, 4.6 among them, make one up from
    SIM_BATT_VOLTAGE, which is then set whenever it is off by 0.03 V.
    """

    def __init__(self) -> None:
        super().__init__()
        self.wanted_v: float | None = None
        """What ArduPilot should report [V]; None: whatever it likes."""
        self._off = 0

    async def open(self, instance: int, host: str) -> None:
        """Connect to ArduPilot's instance on a host; it is tried again until closed.

        Raises
        ------
        LinkOpenError
            If the link cannot work.
        """
        await self.connect(f"tcpout://{host}:{MAVLINK_PORT + 10 * instance}")

    def _hear(self, system_id: int, voltage_v: float) -> None:
        super()._hear(system_id, voltage_v)
        if self.wanted_v is None:
            return
        self._off = self._off + 1 if abs(voltage_v - self.wanted_v) > _OFF_V else 0
        if self._off < _OFF_REPORTS:
            return
        self._off = 0
        self._send(
            mavlink.MAVLink_param_set_message(
                system_id,
                mavlink.MAV_COMP_ID_AUTOPILOT1,
                b"SIM_BATT_VOLTAGE",
                self.wanted_v,
                mavlink.MAV_PARAM_TYPE_REAL32,
            )
        )
