"""What a long steady flight leaves in the log."""

import asyncio
import contextlib
import json
from dataclasses import replace

import pytest
from ports import udp_port
from pymavlink.dialects.v20 import common as mavlink

from swingd.link.codec import Codec
from swingd.model.actions import Health
from swingd.model.parameters import Mode, Parameters
from swingd.service.daemon import Daemon
from swingd.service.logs import Log
from swingd.sim.autopilot import NavState
from swingd.sim.peer import SimulatedAutopilot
from swingd.sim.run import run_simulation

SPEED = 4.0
STEADY_S = 20.0
"""Of simulated time, in OFFBOARD with the correction active."""


class Pilot:
    """Takes off, asks for OFFBOARD as soon as setpoints come, and notes when the health has settled."""

    def __init__(self, log: Log, daemon: Daemon) -> None:
        self._codec = Codec(255, 190)
        self._log, self._daemon = log, daemon
        self._asked_s = 0.0
        self._stopped = False
        self._steady_s: float | None = None

    def _command(self, peer: SimulatedAutopilot, number: int, *params: float) -> None:
        padded = (*params, *(0.0 for _ in range(7 - len(params))))
        peer.receive(self._codec.encode(mavlink.MAVLink_command_long_message(1, 1, number, 0, *padded)))

    def __call__(self, peer: SimulatedAutopilot) -> None:
        reports = peer.companion.reports
        # The autopilot's parameters are read at the wall's pace, whatever that of the flight.
        read = any(text.startswith("preflight: ") for _, _, text in peer.companion.status_texts)
        if self._steady_s is None and read and reports[-1].health is Health.ACTIVE:
            self._steady_s = peer.t_s + 4.0
        if self._steady_s is not None and peer.t_s > self._steady_s + STEADY_S:
            if not self._stopped:  # a second time would not wait for the fade
                self._daemon.stop()
            self._stopped = True
        elif self._steady_s is not None and abs(peer.t_s - self._steady_s) < 0.003:
            self._log.error("steady from here on")
        if peer.t_s < self._asked_s + 1.0 or peer.autopilot.nav_state is NavState.OFFBOARD:
            return
        self._asked_s = peer.t_s
        if not peer.autopilot.armed and peer.t_s > 2.0:
            self._command(peer, mavlink.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, *(float("nan") for _ in range(4)))
            self._command(peer, mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1.0)
        elif peer.companion.setpoints > 50:
            self._command(peer, mavlink.MAV_CMD_DO_SET_MODE, 1.0, 6.0)


@pytest.mark.live
@pytest.mark.alone
async def test_a_steady_flight_says_nothing_and_its_end_is_told_to_the_pilot(
    capsys: pytest.CaptureFixture[str],
) -> None:
    """GIVEN 20 s of a flight that is corrected WHEN nothing happens THEN no line is written, and each was one event."""
    port = udp_port()
    base = Parameters(mode=Mode.HOLD)
    parameters = replace(
        base,
        link=replace(base.link, autopilot=f"udpin://127.0.0.1:{port}"),
        simulation=replace(
            base.simulation,
            mavlink=f"udpout://127.0.0.1:{port}",
            mavlink_bind_port=0,
            speed=SPEED,
            takeoff_altitude_m=4.0,
        ),
    )
    log = Log()
    log.open()
    daemon = Daemon(parameters, log=log)
    peer = SimulatedAutopilot(parameters)
    simulation = asyncio.create_task(run_simulation(parameters, peer=peer, on_step=Pilot(log, daemon)))
    try:
        async with asyncio.timeout(40.0):
            await daemon.run()
    finally:
        simulation.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await simulation
    lines = [json.loads(line) for line in capsys.readouterr().err.splitlines()]
    events = [line["event"] for line in lines]
    assert all({"event", "level", "timestamp"} <= line.keys() for line in lines)
    steady = events.index("steady from here on")
    assert any(event == "swingd active" for event in events[:steady])
    said = events[steady + 1 :]
    # The end itself: the fade, as a change of the correction, and the figures.
    assert said[0] == "correction off", said
    assert said[-1] == "stopped"

    texts = [text for _, _, text in peer.companion.status_texts]
    assert "swingd ends: the autopilot's failsafe acts next" in texts
    assert peer.autopilot.nav_state is NavState.OFFBOARD, "what follows is the autopilot's own to do"
