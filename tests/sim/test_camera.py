"""The camera that sees the load: its pictures, their messages, and what it leaves alone."""

from math import asin, atan2, cos, pi, radians, sin
from typing import Any

import numpy as np
import pytest
from pymavlink.dialects.v20 import common as mavlink

from swingd.link.codec import Framer
from swingd.model.parameters import Simulation
from swingd.sim.camera import EPOCH_US, Camera
from swingd.sim.faults import Fault
from swingd.sim.peer import SimulatedAutopilot
from swingd.sim.plant import DT_S, Plant, Truth, rotation_matrix

from .rigs import QUIET, Application, as_copter, iris, steps, velocity

SURE: dict[str, float] = {"camera_noise_m": 0.0, "camera_noise_share": 0.0, "camera_dropout_share": 0.0}
"""A camera without errors."""
CAMERA = (1, mavlink.MAV_COMP_ID_CAMERA)


def hanging(xi_rad: float = 0.0, zeta_rad: float = 0.0, yaw_rad: float = 0.0) -> list[float]:
    """The plant's state in the air, the load 1.5 m under the vehicle but for the swing."""
    plant = Plant(iris())
    plant.place((10.0, -20.0, -50.0), yaw_rad=yaw_rad, xi_rad=xi_rad, zeta_rad=zeta_rad)
    return plant.state


def seen(
    state: list[float], duration_s: float, *, attached: bool = True, **simulation: Any
) -> list[tuple[float, mavlink.MAVLink_landing_target_message]]:
    """Time and message of all that a camera over a standing world tells."""
    camera = Camera(Simulation(**{"camera_hz": 15.0, **SURE, **simulation}))
    told = ((step * DT_S, camera.step(step, state, attached=attached)) for step in range(1, steps(duration_s) + 1))
    return [(t_s, message) for t_s, message in told if message is not None]


def taken_s(message: mavlink.MAVLink_landing_target_message) -> float:
    return (message.time_usec - EPOCH_US) / 1e6


def position(message: mavlink.MAVLink_landing_target_message) -> list[float]:
    return [message.x, message.y, message.z]


def true_position(truth: Truth) -> np.ndarray:
    ned = np.subtract(truth.load_pos_ned_m, truth.pos_ned_m)
    return np.array(rotation_matrix(*truth.ned_from_frd)).T @ ned


def camera_frames(app: Application) -> list[tuple[float, Any]]:
    return [(t_s, message) for t_s, message in app.messages if message.get_type() == "LANDING_TARGET"]


@pytest.fixture(scope="module")
def flight() -> Application:
    """Takes off, waits, and darts forward by its nose, which points east; with a camera that errs in nothing."""
    app = Application(iris(camera_hz=20.0, **SURE))
    app.keep = True
    app.take_off()
    app.offboard(lambda t_s: velocity(0.0, 0.0, yaw=0.5 * pi))
    app.run(8.0)
    app.messages.clear()
    app.setpoint = lambda t_s: velocity(0.0, 2.0, yaw=0.5 * pi)
    app.run(1.5)
    return app


# ---- pictures


@pytest.mark.parametrize("hz", [0.5, 7.0, 15.0, 30.0, 62.5, 120.0])
def test_pictures_come_at_the_given_rate(hz: float) -> None:
    """Also one that does not divide 250 Hz: the step to which a picture waits does not shift the next."""
    stamps = [taken_s(message) for _, message in seen(hanging(), 20.0, camera_hz=hz, camera_delay_s=0.0)]
    assert len(stamps) == int(20.0 * hz)
    late_s = np.array(stamps) - np.arange(1, len(stamps) + 1) / hz
    assert late_s.min() > -1e-6
    assert late_s.max() < DT_S


@pytest.mark.parametrize("delay_s", [0.0, 0.08, 1.0])
def test_a_message_leaves_the_delay_after_its_picture_and_says_when_that_was(delay_s: float) -> None:
    told = seen(hanging(), 3.0, camera_hz=120.0, camera_delay_s=delay_s)
    assert len(told) == pytest.approx(120.0 * (3.0 - delay_s), abs=1)
    assert [t_s - taken_s(message) for t_s, message in told] == pytest.approx([delay_s] * len(told), abs=1e-6)


def test_a_message_shows_the_load_where_it_was_at_the_picture() -> None:
    """The world moves on between picture and message."""
    before, after = hanging(zeta_rad=0.2), hanging(zeta_rad=-0.2)
    camera = Camera(Simulation(camera_hz=10.0, camera_delay_s=0.08, **SURE))
    told = [camera.step(step, before if step <= 25 else after, attached=True) for step in range(1, 50)]
    ((index, message),) = ((index, message) for index, message in enumerate(told) if message is not None)
    assert (index + 1) * DT_S == pytest.approx(0.18)
    assert taken_s(message) == pytest.approx(0.1)
    assert message.x > 0.0


def test_the_axes_are_those_of_the_body() -> None:
    """Whatever the heading: ahead is x, to the right is y; the load to the left is a positive lateral swing."""
    for yaw_rad in (0.0, 1.0, -2.5):
        _, ahead = seen(hanging(zeta_rad=0.3, yaw_rad=yaw_rad), 1.0)[0]
        _, left = seen(hanging(xi_rad=0.3, yaw_rad=yaw_rad), 1.0)[0]
        length = ahead.distance
        assert length == pytest.approx(1.5, abs=0.01)
        assert position(ahead) == pytest.approx([length * sin(0.3), 0.0, length * cos(0.3)], abs=1e-6)
        assert position(left) == pytest.approx([0.0, -length * sin(0.3), length * cos(0.3)], abs=1e-3)


def test_the_body_s_tilt_shows() -> None:
    """Nose up by 0.2 rad over a load straight below: it is seen behind, by the angle of the tilt."""
    state = hanging()
    state[6:10] = [cos(0.1), 0.0, sin(0.1), 0.0]
    _, message = seen(state, 1.0)[0]
    assert message.x < 0.0
    assert asin(message.x / message.distance) == pytest.approx(-0.2)


def test_angles_are_those_in_a_picture_whose_top_is_ahead() -> None:
    """To the right and towards the bottom, as ArduPilot's precision landing takes them."""
    _, message = seen(hanging(xi_rad=-0.2, zeta_rad=0.1), 1.0)[0]
    assert message.angle_x == pytest.approx(0.2, abs=0.02)
    assert message.angle_y == pytest.approx(-0.1, abs=0.02)
    los = np.array([-np.tan(message.angle_y), np.tan(message.angle_x), 1.0])
    assert los / np.linalg.norm(los) == pytest.approx(np.array(position(message)) / message.distance)


@pytest.mark.parametrize("half_angle_deg", [10.0, 30.0, 60.0])
def test_outside_of_the_field_of_view_nothing_is_seen(half_angle_deg: float) -> None:
    def sees(state: list[float]) -> bool:
        return bool(seen(state, 1.0, camera_half_angle_rad=radians(half_angle_deg)))

    edge = radians(half_angle_deg)
    for sign in (1.0, -1.0):
        assert sees(hanging(xi_rad=sign * (edge - 0.01)))
        assert sees(hanging(zeta_rad=sign * (edge - 0.01)))
        assert not sees(hanging(xi_rad=sign * (edge + 0.01)))
        assert not sees(hanging(zeta_rad=sign * (edge + 0.01)))
    # The field turns with the body: a tilt brings into it what hangs beside it.
    state = hanging(zeta_rad=edge + 0.1)
    state[6:10] = [cos(0.15), 0.0, sin(0.15), 0.0]
    assert sees(state)


def test_a_load_over_the_vehicle_is_not_seen() -> None:
    state = hanging()
    state[19] = state[2] - 1.0
    assert seen(state, 1.0, camera_half_angle_rad=1.57) == []


def test_without_a_load_on_the_cable_nothing_is_told() -> None:
    assert seen(hanging(), 5.0, attached=False) == []


# ---- errors


def test_noise_has_the_configured_deviation_on_every_axis() -> None:
    """noise_m + share * distance, white from picture to picture and from axis to axis."""
    state = hanging(zeta_rad=0.2)
    _, sure = seen(state, 1.0)[0]
    told = seen(state, 200.0, camera_hz=100.0, camera_noise_m=0.03, camera_noise_share=0.02)
    errors = np.array([position(message) for _, message in told]) - position(sure)
    n = len(errors)
    std = 0.03 + 0.02 * sure.distance
    assert errors.std(axis=0) == pytest.approx([std] * 3, rel=5.0 / np.sqrt(2 * n))
    assert errors.mean(axis=0) == pytest.approx([0.0] * 3, abs=5.0 * std / np.sqrt(n))
    correlation = np.corrcoef(np.hstack([errors[1:], errors[:-1]]).T) - np.eye(6)
    assert np.abs(correlation).max() < 5.0 / np.sqrt(n)
    for _, message in told[:50]:
        assert message.distance == pytest.approx(np.linalg.norm(position(message)))
        assert message.angle_x == pytest.approx(atan2(message.y, message.z))


@pytest.mark.parametrize(("share", "dropout_s"), [(0.1, 0.5), (0.4, 0.25)])
def test_dropouts_take_their_share_of_the_time_and_last_as_long_as_given(share: float, dropout_s: float) -> None:
    duration_s, hz = 4000.0, 20.0
    told = seen(
        hanging(), duration_s, camera_hz=hz, camera_delay_s=0.0, camera_dropout_share=share, camera_dropout_s=dropout_s
    )
    lost = 1.0 - len(told) / (duration_s * hz)
    # An alternating renewal process: of the share's variance, only the times between dropouts contribute.
    dropouts = duration_s * share / dropout_s
    assert lost == pytest.approx(share, abs=4.0 * share * (1.0 - share) / np.sqrt(dropouts))
    gaps_s = np.diff([taken_s(message) for _, message in told])
    blind_s = gaps_s[gaps_s > 1.5 / hz]
    assert blind_s.min() > dropout_s - 1e-6
    # Most dropouts stand alone, each between the last picture before it and the first one after.
    assert np.median(blind_s) == pytest.approx(dropout_s + 1.0 / hz, abs=2.0 * DT_S)


def test_dropouts_of_no_share_do_not_happen() -> None:
    assert len(seen(hanging(), 100.0, camera_delay_s=0.0)) == 1500


def test_neither_dropouts_nor_absence_change_the_noise_of_other_pictures() -> None:
    noisy = {"camera_noise_m": 0.1, "camera_delay_s": 0.0}
    whole = {message.time_usec: position(message) for _, message in seen(hanging(), 60.0, **noisy)}
    holed = {
        message.time_usec: position(message) for _, message in seen(hanging(), 60.0, camera_dropout_share=0.3, **noisy)
    }
    assert 0 < len(holed) < len(whole)
    assert all(whole[stamp] == place for stamp, place in holed.items())


# ---- on the link


def test_the_frame_is_a_landing_target_of_the_vehicle_s_camera() -> None:
    """Packed, parsed by pymavlink: every field."""
    parser = mavlink.MAVLink(None)
    peer = SimulatedAutopilot(iris(camera_hz=15.0, **SURE))
    peer.plant.place((0.0, 0.0, -50.0), xi_rad=0.1, zeta_rad=0.2)
    messages = [parser.decode(bytearray(raw)) for raw in peer.advance(0.2)]
    (message,) = (message for message in messages if message.get_type() == "LANDING_TARGET")
    assert (message.get_srcSystem(), message.get_srcComponent()) == CAMERA
    assert message.time_usec == EPOCH_US + 68_000
    assert message.target_num == 0
    assert message.frame == mavlink.MAV_FRAME_BODY_FRD
    assert message.type == mavlink.LANDING_TARGET_TYPE_VISION_FIDUCIAL
    assert message.position_valid == 1
    assert message.q == [1.0, 0.0, 0.0, 0.0]
    assert (message.size_x, message.size_y) == (0.0, 0.0)
    assert message.x > 0.0
    assert message.y < 0.0
    assert message.distance == pytest.approx(np.linalg.norm(position(message)), rel=1e-6)
    assert message.angle_x == pytest.approx(atan2(message.y, message.z), rel=1e-6)
    assert message.angle_y == pytest.approx(atan2(-message.x, message.z), rel=1e-6)


def test_in_flight_the_camera_tells_the_truth_of_its_picture(flight: Application) -> None:
    """Positions agree with the truth at the stamp, to the accuracy of a float, and not with that at the message."""
    truths = {round(1e6 * truth.t_boot_s): truth for truth in flight.truths}
    checked = late = 0
    for t_s, message in camera_frames(flight):
        truth = truths.get(message.time_usec - EPOCH_US)
        if truth is not None:
            assert position(message) == pytest.approx(true_position(truth), abs=1e-5)
            late += bool(np.abs(position(message) - true_position(truths[round(1e6 * t_s)])).max() > 0.01)
            checked += 1
    assert checked == pytest.approx(20.0 * (1.5 - 0.08), abs=1)
    assert late > 10


def test_a_load_that_trails_is_seen_behind_by_a_level_body() -> None:
    """As of a vehicle that accelerates forward, or to the right: behind, x < 0, or to the left, y < 0."""
    assert all(message.x < -0.1 for _, message in seen(hanging(zeta_rad=-0.1), 1.0))
    assert all(message.y < -0.1 for _, message in seen(hanging(xi_rad=0.1), 1.0))


def test_a_vehicle_that_darts_forward_leaves_its_load_behind(flight: Application) -> None:
    """The nose points east, and goes down first: over a load that still hangs below, which so comes ahead of the body.

    Turned back by the attitude, what is seen is below before the start, and behind as long as the vehicle accelerates.
    """
    start_s, first = flight.truths[0].t_boot_s, camera_frames(flight)[0][1]
    assert position(first) == pytest.approx([0.0, 0.0, 1.5], abs=0.1)
    truths = {round(1e6 * truth.t_boot_s): truth for truth in flight.truths}
    ahead, behind = [], []
    for _, message in camera_frames(flight):
        truth = truths.get(message.time_usec - EPOCH_US)
        if truth is None:
            continue
        east = float(np.array(rotation_matrix(*truth.ned_from_frd))[1] @ position(message))
        assert abs(message.y) < 0.1
        if truth.t_boot_s - start_s < 0.3:
            ahead.append(message.x)
        elif truth.acc_ned_mps2[1] > 0.5:
            behind.append(east)
    assert max(ahead) > 0.1
    assert len(behind) > 5
    assert max(behind) < -0.05


@pytest.mark.parametrize("copter", [False, True])
def test_a_camera_changes_nothing_else(copter: bool) -> None:
    """Without its frames, a flight with a camera is byte for byte one without, and so is the truth."""

    def fly(camera_hz: float) -> tuple[list[bytes], list[bytes], Truth]:
        noise = {**QUIET, "acc_noise_mps2": 0.1, "gyro_noise_radps": 0.01, "gust_std_mps": 1.0}
        parameters = iris(**noise, camera_hz=camera_hz)
        app = Application(as_copter(parameters) if copter else parameters)
        frames: list[bytes] = []
        companion = app.lockstep._companion

        def listening(t_s: float, data: bytes) -> bytes:
            frames.extend(frame.raw for frame in Framer().receive(data))
            return companion(t_s, data)

        app.lockstep._companion = listening
        if copter:
            app.take_off_guided(4.0)
        else:
            app.take_off()
        own = [raw for raw in frames if (raw[5], raw[6]) != CAMERA]
        return own, [raw for raw in frames if (raw[5], raw[6]) == CAMERA], app.peer.truth()

    own, none, truth = fly(0.0)
    own_beside, of_camera, truth_beside = fly(30.0)
    assert none == []
    assert len(of_camera) > 100
    assert own == own_beside
    assert truth == truth_beside


def test_the_seed_decides_what_a_camera_tells() -> None:
    def told(seed: int) -> list[bytes]:
        peer = SimulatedAutopilot(iris(camera_hz=30.0, seed=seed))
        peer.plant.place((0.0, 0.0, -50.0))
        return [raw for raw in peer.advance(2.0) if raw[6] == mavlink.MAV_COMP_ID_CAMERA]

    assert told(1) == told(1)
    assert told(1) != told(2)


def falling(**simulation: Any) -> SimulatedAutopilot:
    """High in the air, the load seen under the vehicle as both fall side by side."""
    peer = SimulatedAutopilot(iris(camera_hz=25.0, **SURE, **simulation))
    peer.plant.place((0.0, 0.0, -5000.0))
    return peer


def stamps(peer: SimulatedAutopilot, t_s: float) -> list[tuple[int, int]]:
    """Sequence number and stamp [ms since the start] of what the camera tells up to ``t_s``."""
    framer = Framer()
    frames = [frame for raw in peer.advance(t_s) for frame in framer.receive(raw) if frame.component_id == CAMERA[1]]
    return [(frame.raw[4], (frame.message.time_usec - EPOCH_US) // 1000) for frame in frames if frame.message]


def test_a_reboot_of_the_autopilot_interrupts_the_camera_s_way_and_not_its_clock() -> None:
    """For 3 s nothing is passed on; then the stamps have gone on, and so have the sequence numbers."""
    peer = falling()
    before = stamps(peer, 1.0)
    peer.reboot()
    assert stamps(peer, 3.9) == []
    peer.plant.place((0.0, 0.0, -5000.0))
    assert stamps(peer, 3.99) == []
    after = stamps(peer, 5.0)
    assert before[-1] == (len(before) - 1, 920)
    assert after[0] == (before[-1][0] + 1, 3920)
    assert np.diff([stamp for _, stamp in before]).tolist() == [40] * (len(before) - 1)


def test_a_released_load_is_not_told_and_one_that_is_hooked_again_is() -> None:
    peer = falling()
    peer.advance(1.0)
    peer.plant.release()
    assert [stamp for _, stamp in stamps(peer, 2.0)] == [960, 1000]  # pictures from before
    peer.plant.hook()
    assert [stamp for _, stamp in stamps(peer, 2.2)] == [2040, 2080, 2120]


def test_faults_of_the_link_are_the_camera_s_as_well_and_the_autopilot_s_clock_is_not() -> None:
    lossy, stepped, whole = falling(), falling(), falling()
    lossy.faults.inject(Fault("gap", None, 1.0, 2.0))
    stepped.faults.inject(Fault("clock", -15.0, 1.0))
    everything = stamps(whole, 3.0)
    assert [stamp for _, stamp in stamps(lossy, 3.0)] == [stamp for _, stamp in everything if not 920 < stamp <= 1920]
    assert stamps(stepped, 3.0) == everything


def test_an_autopilot_that_signs_has_a_camera_that_signs() -> None:
    peer = SimulatedAutopilot(iris(camera_hz=25.0, **SURE), signing_key=bytes(range(32)), signing_start_unix_s=1.8e9)
    peer.plant.place((0.0, 0.0, -50.0))
    frames = [raw for raw in peer.advance(1.0) if raw[6] == CAMERA[1]]
    parser = mavlink.MAVLink(None)
    parser.signing.secret_key = bytes(range(32))
    assert len(frames) == 23
    assert all(parser.check_signature(bytearray(raw), *CAMERA) for raw in frames)
