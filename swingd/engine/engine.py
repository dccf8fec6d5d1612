"""Bytes and ticks in, bytes out: what the daemon, the lockstep simulation and the replay of a recording all run."""

from collections.abc import Callable

from swingd.link.adapter import AutopilotAdapter
from swingd.model.actions import Action, SwingReport
from swingd.model.events import CorrectionSwitch, Event, ParametersChange, Tick
from swingd.model.parameters import Parameters
from swingd.pipeline import Pipeline

_LATE_SHARE = 0.5
"""Of a report's period: the grid of reports is kept although filter steps jitter."""


class Engine:
    """One autopilot's adapter and pipeline.

    Parameters
    ----------
    parameters : Parameters
        Everything that it needs to know.
    on_action : callable, optional
        Sees every action of the pipeline, with the host's time, before it becomes bytes.
    """

    def __init__(self, parameters: Parameters, on_action: Callable[[float, Action], None] | None = None) -> None:
        self.adapter = AutopilotAdapter(parameters.link, parameters.thrust)
        self.pipeline = Pipeline(parameters)
        self._on_action = on_action
        self._report_due_s = 0.0

    def receive(self, t_mono_s: float, data: bytes) -> list[bytes]:
        """Take bytes from the autopilot; return the frames to send to it.

        Parameters
        ----------
        t_mono_s : float
            The host's monotonic clock at their arrival [s].
        data : bytes
            Any part of the stream.
        """
        frames: list[bytes] = []
        for event in self.adapter.receive(t_mono_s, data):
            self._step(event, frames)
        return frames

    def tick(self, t_mono_s: float) -> list[bytes]:
        """Let time pass; to be called at a steady rate of some 20 Hz."""
        return self.step(Tick(t_mono_s))

    def switch_correction(self, t_mono_s: float, enabled: bool) -> list[bytes]:
        """Enable or disable the correction."""
        return self.step(CorrectionSwitch(t_mono_s, enabled))

    def change_parameters(self, t_mono_s: float, parameters: Parameters) -> list[bytes]:
        """Begin anew with other parameters on the same link."""
        return self.step(ParametersChange(t_mono_s, parameters))

    def step(self, event: Event) -> list[bytes]:
        """Take an event that does not come from the autopilot."""
        frames: list[bytes] = []
        self._step(event, frames)
        return frames

    def _step(self, event: Event, frames: list[bytes]) -> None:
        for action in self.pipeline.step(event):
            if self._on_action is not None:
                self._on_action(event.t_mono_s, action)
            if isinstance(action, SwingReport) and not self._report_is_due(action):
                continue
            encoded = self.adapter.encode(action)
            if encoded is not None:
                frames.append(encoded)

    def _report_is_due(self, report: SwingReport) -> bool:
        """Thin the reports out to the rate that the link is to carry."""
        parameters = self.pipeline.parameters
        rate_hz = parameters.link.report_rate_hz
        if rate_hz <= 0.0:
            return False
        early_s = _LATE_SHARE / parameters.estimator.rate_hz
        period_s = 1.0 / rate_hz
        if abs(report.t_boot_s - self._report_due_s) > 2.0 * period_s:
            self._report_due_s = report.t_boot_s
        if report.t_boot_s < self._report_due_s - early_s:
            return False
        self._report_due_s += period_s
        return True
