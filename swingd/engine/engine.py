"""Bytes and ticks in, bytes out: what the daemon, the lockstep simulation and the replay of a recording all run."""

from collections.abc import Callable

from swingd.link.adapter import AutopilotAdapter
from swingd.model.actions import Action, SwingReport
from swingd.model.events import CorrectionSwitch, Event, ParametersChange, Tick
from swingd.model.parameters import Parameters
from swingd.pipeline import Pipeline
from swingd.record.event_log import EventLogWriter, RecordKind

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
    log : EventLogWriter, optional
        Gets every input before it takes effect, and every frame that is answered.
    """

    def __init__(
        self,
        parameters: Parameters,
        on_action: Callable[[float, Action], None] | None = None,
        log: EventLogWriter | None = None,
    ) -> None:
        self.adapter = AutopilotAdapter(parameters.link, parameters.thrust)
        self.pipeline = Pipeline(parameters)
        self._on_action = on_action
        self._log = log
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
        if self._log is not None:
            self._log.write(RecordKind.RECEIVED_AUTOPILOT, t_mono_s, data)
        frames: list[bytes] = []
        for event in self.adapter.receive(t_mono_s, data):
            self._step(event, frames)
        return self._sent(t_mono_s, frames)

    def tick(self, t_mono_s: float) -> list[bytes]:
        """Let time pass; to be called at a steady rate of some 20 Hz."""
        if self._log is not None:
            self._log.tick(t_mono_s)
        return self._take(Tick(t_mono_s))

    def switch_correction(self, t_mono_s: float, enabled: bool) -> list[bytes]:
        """Enable or disable the correction."""
        if self._log is not None:
            self._log.correction(t_mono_s, enabled)
        return self._take(CorrectionSwitch(t_mono_s, enabled))

    def change_parameters(self, t_mono_s: float, parameters: Parameters, text: str) -> list[bytes]:
        """Begin anew with other parameters on the same link; ``text`` is what a log keeps of them."""
        if self._log is not None:
            self._log.parameters(t_mono_s, text)
        self.adapter.configure_motors(parameters.thrust)
        return self._take(ParametersChange(t_mono_s, parameters))

    def _take(self, event: Event) -> list[bytes]:
        frames: list[bytes] = []
        self._step(event, frames)
        return self._sent(event.t_mono_s, frames)

    def _sent(self, t_mono_s: float, frames: list[bytes]) -> list[bytes]:
        if self._log is not None:
            for frame in frames:
                self._log.write(RecordKind.SENT_AUTOPILOT, t_mono_s, frame)
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
