"""One take-off for many flights."""

from collections.abc import Callable

import pytest

from .flight import Flight, hold


@pytest.fixture(scope="session")
def _hovering() -> Flight:
    flight = Flight(hold()).take_off().enter_offboard()
    return flight.run(2.0)


@pytest.fixture
def hovering(_hovering: Flight) -> Callable[[], Flight]:
    """Makes flights that hover in OFFBOARD with the correction active, default parameters."""
    return _hovering.fork
