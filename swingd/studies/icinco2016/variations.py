"""What was chosen, half as large and half as large again: do the conclusions stand?"""

from collections.abc import Iterator
from dataclasses import replace

from swingd.studies.icinco2016.cases import CIRCLE_TORQUE, REGULATION_TORQUE, VARIANTS
from swingd.studies.icinco2016.flight import Scenario, run
from swingd.studies.icinco2016.indicators import indicators
from swingd.studies.seeds import Figures

FACTORS = (0.5, 1.5)
GROUP = "variations/"
RATIOS = ("translational", "rotational")
_GAINS = ("kp", "kd", "kp_pitch", "kd_pitch")
_OTHERS = ("circle_hz", "torque_nm", "torque_for_s")


def varied(scenario: Scenario) -> Iterator[tuple[str, Scenario]]:
    """Yield the scenario as chosen and with one value changed at a time, each with its name."""
    yield "as chosen", scenario
    for name in (*_GAINS, *_OTHERS):
        if name == "circle_hz" and scenario.circle_hz == 0.0:
            continue
        for factor in FACTORS:
            if name in _GAINS:
                gains = replace(scenario.gains, **{name: factor * getattr(scenario.gains, name)})
                yield f"{name} x {factor:g}", replace(scenario, gains=gains)
            else:
                yield f"{name} x {factor:g}", replace(scenario, **{name: factor * getattr(scenario, name)})


def vary(seed: int) -> Figures:
    """Fly the tasks with the torque under every variation.

    Returns
    -------
    dict
        Keys ``variations/circle_torque/kp x 0.5`` and so on. Each holds ``translational``, the RMS tracking error with
        both compensations over that with the rotational one alone, and ``rotational``, the error of x from the torque
        on with both over that with the translational one alone: each layer's compensation where the other one works.

    Raises
    ------
    StudyError
        If a flight diverges.
    """
    figures: Figures = {}
    for scenario in (REGULATION_TORQUE, CIRCLE_TORQUE):
        for name, changed in varied(scenario):
            flown = {
                variant: indicators(run(changed, VARIANTS[variant], seed))
                for variant in ("rotational", "translational", "both")
            }
            figures[f"{GROUP}{scenario.name}/{name}"] = {
                "translational": flown["both"]["error"] / flown["rotational"]["error"],
                "rotational": flown["both"]["error_x_torque"] / flown["translational"]["error_x_torque"],
            }
    return figures
