"""What the software of a simulated autopilot has at hand, whatever its face."""

from collections.abc import Callable, Sequence

from swingd.model.parameters import Parameters
from swingd.sim.autopilot import Autopilot
from swingd.sim.plant import DT_S
from swingd.sim.sensors import Battery, Sensed

_STEP_US = round(DT_S * 1e6)


class Onboard:
    """Clock, estimates, control loops, battery and remote control.

    Parameters
    ----------
    parameters : Parameters
        The vehicle and the simulation.
    make_autopilot : callable
        Makes the control loops, at the start and at each boot.
    """

    def __init__(self, parameters: Parameters, make_autopilot: Callable[[], Autopilot]) -> None:
        self._make_autopilot = make_autopilot
        self.battery = Battery(parameters.simulation)
        self.autopilot = make_autopilot()
        """Modes and control loops."""
        self.sensed = Sensed()
        """The newest sample of everything that is measured."""
        self.steps = 0
        """Steps of `DT_S` since the start."""
        self.boot_step = 0
        """Step of the last boot."""
        self.data_us = 0
        """Stamp of the newest sample [us since boot]."""
        self.rc_channels: Sequence[int] | None = None
        """What the remote control's receiver gives [us of PWM], up to 18 channels; None without a remote control."""

    @property
    def t_boot_s(self) -> float:
        """Time since boot [s]."""
        return (self.steps - self.boot_step) * DT_S

    @property
    def now_us(self) -> int:
        """Time since boot [us]."""
        return (self.steps - self.boot_step) * _STEP_US

    @property
    def data_ms(self) -> int:
        """Stamp of the newest sample [ms since boot]."""
        return self.data_us // 1000

    def boot(self) -> None:
        """Start anew: the clock at zero, the loops at rest."""
        self.autopilot = self._make_autopilot()
        self.boot_step = self.steps
        self.data_us = 0
