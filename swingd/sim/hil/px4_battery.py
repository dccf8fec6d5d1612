"""The battery that a simulated PX4 makes up for itself, read where PX4 tells of it."""

from swingd.sim.hil.battery import ReportedBattery

BATTERY_PORT = 14030
"""UDP port to which PX4's instance 0 talks for a payload computer; instance N talks to this + N."""


class Px4Battery(ReportedBattery):
    """Follow the voltage that one PX4 reports."""

    async def open(self, instance: int) -> None:
        """Listen to PX4's instance.

        Raises
        ------
        LinkOpenError
            If the port is in use.
        """
        await self.connect(f"udpin://127.0.0.1:{BATTERY_PORT + instance}")
