"""What the simulation and ArduPilot's SITL tell each other by MAVLink: battery and frame."""

from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from swingd.sim.hil.battery import ReportedBattery

MAVLINK_PORT = 5763
"""TCP port of ArduPilot's SERIAL2 on instance 0; instance N has this + 10 N."""

_OFF_V = 0.03
_OFF_REPORTS = 5
_QUAD_X = {"FRAME_CLASS": 1.0, "FRAME_TYPE": 1.0}


class ArdupilotMavlink(ReportedBattery):
    """Follow the voltage that one ArduPilot reports, correct it where it is another, and ask which frame it flies.

    Notes
    -----
    Newer ArduPilots take the voltage from their simulator's answers. Others, 4.6 among them, make one up from
    SIM_BATT_VOLTAGE, which is then set whenever it is off by 0.03 V.
    """

    def __init__(self) -> None:
        super().__init__()
        self.wanted_v: float | None = None
        """What ArduPilot should report [V]; None: whatever it likes."""
        self.frame: dict[str, float] = {}
        """FRAME_CLASS and FRAME_TYPE, once known."""
        self._off = 0

    @property
    def other_frame(self) -> bool:
        """Whether ArduPilot is known to mix its motors for another frame than a quad x."""
        return any(self.frame.get(name, value) != value for name, value in _QUAD_X.items())

    async def open(self, instance: int, host: str) -> None:
        """Connect to ArduPilot's instance on a host; it is tried again until closed.

        Raises
        ------
        LinkOpenError
            If the link cannot work.
        """
        await self.connect(f"tcpout://{host}:{MAVLINK_PORT + 10 * instance}")

    def _take(self, system_id: int, message: Any) -> None:
        super()._take(system_id, message)
        if message.get_type() == "PARAM_VALUE" and message.param_id in _QUAD_X:
            self.frame[message.param_id] = message.param_value

    def _hear(self, system_id: int, voltage_v: float) -> None:
        super()._hear(system_id, voltage_v)
        if self._reports == 1:
            for name in _QUAD_X:
                self._send(
                    mavlink.MAVLink_param_request_read_message(
                        system_id, mavlink.MAV_COMP_ID_AUTOPILOT1, name.encode("ascii"), -1
                    )
                )
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
