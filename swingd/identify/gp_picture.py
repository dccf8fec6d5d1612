"""What a Gaussian process learned of the cable's acceleration, as a picture."""

from pathlib import Path

import numpy as np

from swingd.estimation.acceleration_model import correction
from swingd.identify.gp_training import Training


def draw(training: Training, title: str, path: Path) -> None:
    """Write a picture: held-out errors and what the model says of them, and the model along r and along v."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9, 7.5), layout="constrained")
    FigureCanvasAgg(figure)
    grid = figure.add_gridspec(3, 1)
    score = training.score
    for output, name in enumerate(("north", "east")):
        axis = figure.add_subplot(grid[output])
        at = np.arange(len(training.held_out.error))
        mean, std = training.held_out_mean[:, output], training.held_out_std[:, output]
        axis.plot(at, training.held_out.error[:, output], ".", color="0.6", ms=3, label="held out")
        axis.plot(at, mean, color="#0072B2", lw=1.0, label="model")
        axis.fill_between(at, mean - 2.0 * std, mean + 2.0 * std, color="#0072B2", alpha=0.15, lw=0, label="2 sigma")
        axis.set_ylabel(f"{name} [m/s²]")
        axis.grid(alpha=0.3)
        axis.margins(x=0.01)
        if output == 0:
            axis.legend(loc="upper right", ncols=3, fontsize="small")
            axis.set_title(
                f"acceleration error: RMSE {score.rmse_before:.3g} -> {score.rmse_after:.3g} m/s², "
                f"log likelihood {score.log_likelihood_before:.3g} -> {score.log_likelihood_after:.3g}",
                fontsize="medium",
            )
        else:
            axis.set_xlabel("held-out sample")
    prepared = training.model.prepare()
    panels = [(0, "r [m]"), (2, "v [m/s]"), (4, "load's velocity [m/s]")][: training.trained.z.shape[1] // 2]
    row = grid[2].subgridspec(1, len(panels))
    slices = [figure.add_subplot(row[column]) for column in range(len(panels))]
    for column, (first, label) in enumerate(panels):
        axis = slices[column]
        reach = float(np.abs(training.trained.z[:, first : first + 2]).max())
        along = np.linspace(-reach, reach, 121)
        for output, (name, color) in enumerate((("north", "#D55E00"), ("east", "#009E73"))):
            points = np.zeros((len(along), training.trained.z.shape[1]))
            points[:, first + output] = along
            mean_all, var_all = correction(prepared, points)
            mean, std = mean_all[:, output], np.sqrt(var_all[:, output])
            axis.plot(along, mean, color=color, label=name)
            axis.fill_between(along, mean - std, mean + std, color=color, alpha=0.12, lw=0)
        axis.set_xlabel(label)
        axis.grid(alpha=0.3)
        if column == 0:
            axis.set_ylabel("model ± sigma [m/s²]")
            axis.legend(fontsize="small")
    figure.suptitle(title)
    figure.savefig(path, dpi=100)
