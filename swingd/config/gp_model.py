"""The learned acceleration model that a configuration names: read once, judged, and kept as text."""

import json
from pathlib import Path

from swingd.config.source import read_named
from swingd.model.errors import ConfigurationError
from swingd.model.parameters import Parameters


def read_gp_model(parameters: Parameters, folder: Path) -> str:
    """Read and judge the file that ``gp_ekf.model`` names.

    Parameters
    ----------
    parameters : Parameters
        Vehicle, load and cable, that the model must have been trained for.
    folder : Path
        What the name is relative to.

    Returns
    -------
    str
        The model as one line of JSON; empty without a model.

    Raises
    ------
    ConfigurationError
        If the file cannot be read, is no model, or was trained for another vehicle.
    """
    if parameters.gp_ekf.model == "none":
        return ""
    text = read_named(folder, parameters.gp_ekf.model)
    # It brings the kernels, which a configuration without a model does not need.
    from swingd.estimation.acceleration_model import TRAINED_SHARE_MAX, AccelerationModel

    model = AccelerationModel.from_json(text, parameters.gp_ekf.model)
    model.prepare()
    misfit = model.misfit(parameters.vehicle.mass_kg, parameters.payload.mass_kg, parameters.cable.length_m)
    if misfit:
        raise ConfigurationError(
            f"{parameters.gp_ekf.model}: {misfit}; expected a model of this vehicle and load, within "
            f"{TRAINED_SHARE_MAX:.0%}"
        )
    return one_line(text)


def is_current(parameters: Parameters, folder: Path) -> bool:
    """Whether the file that ``gp_ekf.model`` names still says what the parameters hold."""
    if parameters.gp_ekf.model == "none":
        return not parameters.gp_ekf.model_text
    try:
        return one_line(read_named(folder, parameters.gp_ekf.model)) == parameters.gp_ekf.model_text
    except (ConfigurationError, ValueError, RecursionError):
        return False


def one_line(text: str) -> str:
    """Write JSON without its line breaks; the numbers survive it exactly."""
    return json.dumps(json.loads(text), separators=(",", ":"))
