"""MAVLink's routing rules."""

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common as mavlink

from swingd.link.codec import Encoder, Frame, Framer
from swingd.link.router import AUTOPILOT, Refusal, Router, endpoint_of, peer_of, port_of

APP, GROUND = port_of(0, 0), port_of(1, 3)


def frame(message: object, system: int = 1, component: int = 1) -> Frame:
    (only,) = Framer().receive(Encoder(system, component).encode(message))
    return only


def heartbeat(system: int = 1, component: int = 1) -> Frame:
    return frame(mavlink.MAVLink_heartbeat_message(2, 12, 0, 0, 0, 3), system, component)


def command(target: tuple[int, int], system: int = 255, component: int = 190, first: float = 0.0) -> Frame:
    message = mavlink.MAVLink_command_long_message(*target, 400, 0, first, 0, 0, 0, 0, 0, 0)
    return frame(message, system, component)


@pytest.fixture
def router() -> Router:
    """An autopilot with a gimbal, an application and a ground station, all heard."""
    router = Router()
    router.open(APP)
    router.open(GROUND)
    for port, system, component in ((AUTOPILOT, 1, 1), (AUTOPILOT, 1, 154), (APP, 245, 191), (GROUND, 255, 190)):
        router.route(port, heartbeat(system, component))
    return router


def test_what_has_no_target_goes_to_everybody_else(router: Router) -> None:
    assert router.route(AUTOPILOT, heartbeat()) == (APP, GROUND)
    assert router.route(APP, heartbeat(245, 191)) == (AUTOPILOT, GROUND)


def test_a_target_of_system_0_is_everybody(router: Router) -> None:
    assert router.route(GROUND, command((0, 0))) == (AUTOPILOT, APP)
    assert router.route(GROUND, command((0, 1))) == (AUTOPILOT, APP)


@pytest.mark.parametrize("target", [(1, 1), (1, 0), (1, 154)])
def test_what_has_a_target_goes_where_it_was_heard(router: Router, target: tuple[int, int]) -> None:
    assert router.route(GROUND, command(target)) == (AUTOPILOT,)
    assert router.route(AUTOPILOT, command((255, 190), 1, 1)) == (GROUND,)
    assert router.route(APP, command((255, 0), 245, 191)) == (GROUND,)


@pytest.mark.parametrize("target", [(7, 1), (1, 42)])
def test_a_target_that_was_never_heard_gets_nothing(router: Router, target: tuple[int, int]) -> None:
    assert router.route(GROUND, command(target)) == ()
    assert router.refusals == {Refusal.NO_ROUTE: 1}


def test_nothing_returns_to_where_it_came_from(router: Router) -> None:
    assert router.route(AUTOPILOT, command((1, 154), 1, 1)) == ()
    assert APP not in router.route(APP, command((245, 191), 245, 191))


def test_a_new_peer_hears_broadcasts_before_it_speaks(router: Router) -> None:
    late = port_of(0, 1)
    router.open(late)
    assert router.route(AUTOPILOT, heartbeat()) == (APP, GROUND, late)
    router.close(late)
    assert router.route(AUTOPILOT, heartbeat()) == (APP, GROUND)


def test_a_peer_that_is_gone_is_not_sent_to_and_not_believed(router: Router) -> None:
    router.close(GROUND)
    assert router.route(AUTOPILOT, heartbeat()) == (APP,)
    assert router.route(APP, command((255, 190), 245, 191)) == ()
    assert router.route(GROUND, heartbeat(255, 190)) == ()


def test_a_ground_station_with_two_links_hears_no_echo_and_closes_no_loop(router: Router) -> None:
    """GIVEN one that is heard behind the autopilot and at an endpoint WHEN a frame returns THEN it ends there."""
    said = heartbeat(255, 190)
    assert router.route(AUTOPILOT, said) == (APP,), "not to the link on which it is heard itself"
    assert router.route(GROUND, said) == (), "the same bytes again"
    assert router.refusals[Refusal.LOOP] == 1
    # What is addressed may still take the short way.
    assert router.route(GROUND, command((1, 1))) == (AUTOPILOT,)
    assert router.route(AUTOPILOT, command((1, 1))) == (), "and does not come round"


def test_one_that_says_the_same_for_ever_is_not_taken_for_a_loop(router: Router) -> None:
    encoder = Encoder(255, 190)
    router.route(AUTOPILOT, heartbeat(255, 190))
    message = mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 0, 3)
    for _ in range(1000):
        (said,) = Framer().receive(encoder.encode(message))
        assert AUTOPILOT not in router.route(GROUND, said)
        assert APP in router.route(GROUND, Framer().receive(encoder.encode(message))[0])
    assert router.refusals[Refusal.LOOP] == 0


def test_unknown_messages_and_mavlink_1_pass(router: Router) -> None:
    v1 = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
    raw = mavlink.MAVLink_heartbeat_message(2, 12, 0, 0, 0, 3).pack(v1, force_mavlink1=True)
    (old,) = Framer().receive(raw)
    assert not old.is_v2
    assert router.route(AUTOPILOT, old) == (APP, GROUND)
    unknown = Frame(bytes((0xFD, 1, 0, 0, 9, 1, 1, 0x39, 0x30, 0xC0, 5, 0, 0)), 0xC03039, 1, 1)
    assert router.route(AUTOPILOT, unknown) == (APP, GROUND)


@given(st.lists(st.tuples(st.integers(1, 255), st.integers(1, 255)), max_size=600), st.integers(0, 255))
def test_floods_of_senders_fill_nothing(senders: list[tuple[int, int]], target: int) -> None:
    router = Router()
    router.open(APP)
    for system, component in senders:
        assert set(router.route(APP, command((target, 1), system, component))) <= {AUTOPILOT}
    assert router.sources(APP) <= 256


@given(st.integers(0, 15), st.integers(0, 2**30))
def test_ports_tell_their_endpoint_and_peer(endpoint: int, peer: int) -> None:
    port = port_of(endpoint, peer)
    assert port != AUTOPILOT
    assert endpoint_of(port) == endpoint
    assert peer_of(port) == peer % 2**24
