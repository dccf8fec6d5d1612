"""One take-off for many flights."""

from collections.abc import Callable

import pytest

from .flight import Flight, hold


@pytest.fixture(scope="session")
def taken_off() -> Flight:
    """In the air, not in OFFBOARD, with the records since the start; only to be looked at and forked."""
    return Flight(hold()).take_off()


@pytest.fixture(scope="session")
def _hovering(taken_off: Flight) -> Flight:
    return taken_off.fork().enter_offboard().run(2.0)


@pytest.fixture
def hovering(_hovering: Flight) -> Callable[[], Flight]:
    """Makes flights that hover in OFFBOARD with the correction active, default parameters."""
    return _hovering.fork
