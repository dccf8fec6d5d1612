"""Measured against fitted thrust as a picture."""

from pathlib import Path

import numpy as np

from swingd.identify.thrust_curve import ThrustCurve


def draw(curve: ThrustCurve, title: str, path: Path) -> None:
    """Write a picture: thrust over throttle, and the curve's error with and without the voltage."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, 5), layout="constrained")
    FigureCanvasAgg(figure)
    left, right = figure.subplots(1, 2)
    measured = np.isfinite(curve.voltage_v).all()
    shown = left.scatter(
        curve.throttle, curve.thrust_n, c=curve.voltage_v if measured else None, s=14, cmap="viridis", label="measured"
    )
    x = np.linspace(0.0, 1.0, 101)
    nominal = np.full_like(x, curve.voltage_nominal_v)
    left.plot(
        x, curve.thrust_at(x, nominal), color="black", lw=1.2, label=f"fitted, at {curve.voltage_nominal_v:.4g} V"
    )
    if measured:
        figure.colorbar(shown, ax=left, label="voltage [V]")
        lowest = float(curve.voltage_v.min())
        left.plot(
            x, curve.thrust_at(x, np.full_like(x, lowest)), color="black", lw=1.0, ls="--", label=f"at {lowest:.4g} V"
        )
    left.set(xlabel="throttle", ylabel="thrust [N]", xlim=(0.0, 1.0))
    left.set_ylim(bottom=0.0)
    against = curve.voltage_v if measured else curve.throttle
    for compensated, colour, label in ((False, "tab:orange", "without voltage"), (True, "tab:blue", "with voltage")):
        error = 100.0 * (curve.thrust_at(curve.throttle, curve.voltage_v, compensated) / curve.thrust_n - 1.0)
        right.plot(against, error, ".", color=colour, ms=5, label=label)
    right.axhline(0.0, color="0.5", lw=0.8)
    right.set(xlabel="voltage [V]" if measured else "throttle", ylabel="curve over measured, less 1 [%]")
    for axis in (left, right):
        axis.grid(alpha=0.3)
        axis.legend(fontsize="small")
    figure.suptitle(title)
    figure.savefig(path, dpi=100)
