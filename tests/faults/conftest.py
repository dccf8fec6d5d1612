"""One take-off for all scenarios, and the flights that they are held against."""

import pytest
from engine.flight import Flight

from .scenarios import Record, blown, fly, hovering


@pytest.fixture(scope="session")
def calm() -> Flight:
    """Hovering in still air; only to be forked."""
    return hovering()


@pytest.fixture(scope="session")
def exposed() -> Flight:
    """Hovering as well, a vehicle and a load that the wind pushes; only to be forked."""
    return hovering(blown())


@pytest.fixture(scope="session")
def unspoiled(calm: Flight) -> Record:
    return fly(calm)


@pytest.fixture(scope="session")
def uncorrected(calm: Flight) -> Record:
    """The same manoeuvre without fault and without correction."""
    return fly(calm, corrected=False)
