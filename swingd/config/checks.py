"""What the schema cannot tell: values that do not go together, and URLs that no link understands."""

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

from swingd.config.schema import LIST_MAX
from swingd.control.summary import curve_thrust_n, hover_thrust_n, swing_free
from swingd.link.url import LOOPBACK, parse_url, taken_by
from swingd.model.errors import LinkUrlError
from swingd.model.parameters import LEG_MIN_M, Mode, Parameters, ThrustSource

HOVER_THROTTLE_MAX = 0.95
"""Above, nothing is left to climb, to brake or to correct with."""
MASS_RATIO_MIN = 0.005
"""Below, the load's pull is lost in the accelerometer's noise."""
MASS_RATIO_MAX = 2.0
"""Above, a mass was most likely written in another unit."""
STEPS_PER_SWING_MIN = 20.0
"""Filter steps in one period of the swing; fewer and the discretisation damps what it should estimate."""


@dataclass(frozen=True, slots=True)
class Check:
    """One condition, mostly on several keys."""

    keys: tuple[str, ...]
    """Dotted keys it reads; a violation is reported at the first one that is given."""
    find: Callable[[Parameters], str | None]
    """Gives the violation in words, or None."""


def _voltages(p: Parameters) -> str | None:
    low, nominal, high = p.thrust.voltage_min_v, p.thrust.voltage_nominal_v, p.thrust.voltage_max_v
    if low < nominal < high:
        return None
    return (
        f"thrust.voltage_nominal_v is {nominal:g} V; expected it between thrust.voltage_min_v, {low:g} V, and "
        f"thrust.voltage_max_v, {high:g} V, or every reading near it is refused"
    )


def _motor_outputs(p: Parameters) -> str | None:
    if p.thrust.motor_output_min != p.thrust.motor_output_max:
        return None
    return (
        f"thrust.motor_output_min and thrust.motor_output_max are both {p.thrust.motor_output_min:g}; "
        "expected the outputs at zero and at full throttle, 1000 and 2000 for PWM"
    )


def _curve(p: Parameters) -> str | None:
    a, b, c = p.thrust.quadratic_n, p.thrust.linear_n, p.thrust.offset_n
    if c < 0.0:
        return f"the curve gives {c:g} N at zero throttle; expected thrust.offset_n of 0 or more"
    # A parabola rises on the whole of 0..1 if it rises at both ends.
    if b < 0.0:
        return f"the curve falls at zero throttle by {-b:g} N per unit; expected thrust.linear_n of 0 or more"
    if 2.0 * a + b < 0.0:
        return (
            f"the curve falls again above {-b / (2.0 * a):.0%} throttle; "
            f"expected thrust.quadratic_n of at least -thrust.linear_n / 2 = {0.0 - b / 2.0:g} N"
        )
    if a + b <= 0.0:
        return "the curve does not rise with the throttle; expected thrust.quadratic_n + thrust.linear_n above 0 N"
    return None


def _disturbance(p: Parameters) -> str | None:
    if p.disturbance.source == "none":
        if p.disturbance.feed_forward:
            return "disturbance.feed_forward needs an estimate; expected disturbance.source: es_lkf"
        return None
    if p.thrust.source is ThrustSource.REMARK_1:
        return (
            "thrust.source remark_1 takes the thrust from the load's weight and the acceleration, which leaves no "
            "disturbance to be seen; expected motors, throttle or auto"
        )
    return None


def _waypoints(p: Parameters) -> str | None:
    if p.mode is not Mode.PATH or p.path.source != "configuration":
        return None
    if not p.waypoints:
        return "mode path leads the load through waypoints and there are none; expected one, such as [{north_m: 20}]"
    places = [(w.north_m, w.east_m, w.down_m) for w in p.waypoints]
    for number, (before, place) in enumerate(itertools.pairwise(places), 2):
        apart_m = math.dist(before, place)
        if apart_m < LEG_MIN_M:
            return f"waypoint {number} is {apart_m:.3g} m from the one before; expected at least {LEG_MIN_M:g} m"
    return None


def _path_thrust(p: Parameters) -> str | None:
    if p.mode is not Mode.PATH or p.thrust.source is not ThrustSource.REMARK_1:
        return None
    return (
        "thrust.source remark_1 takes the thrust from the load's weight, which leaves no disturbance to be seen; mode "
        "path expects motors, throttle or auto"
    )


def _camera(p: Parameters) -> str | None:
    if p.camera.source == "none" or p.estimator.name == "gp-ekf":
        return None
    return (
        f"camera.source is {p.camera.source} and estimator.name is {p.estimator.name}, which takes none; expected "
        "gp-ekf, or camera.source none"
    )


def _gp_ekf_thrust(p: Parameters) -> str | None:
    if p.estimator.name != "gp-ekf" or p.thrust.source is not ThrustSource.REMARK_1:
        return None
    return (
        "thrust.source remark_1 takes the thrust from the acceleration, and gp-ekf predicts the acceleration from the "
        "thrust; expected motors, throttle or auto"
    )


def _hover(p: Parameters) -> str | None:
    # Remark 1 reads no curve, and one that does not rise has been reported as such.
    if p.thrust.source is ThrustSource.REMARK_1 or _curve(p) is not None:
        return None
    needed_n = hover_thrust_n(p)
    available_n = curve_thrust_n(p.thrust, HOVER_THROTTLE_MAX, p.thrust.voltage_nominal_v)
    if needed_n < available_n:
        return None
    return (
        f"{p.vehicle.mass_kg:g} kg with a load of {p.payload.mass_kg:g} kg need {needed_n:.1f} N to hover, but the "
        f"curve gives {available_n:.1f} N at {HOVER_THROTTLE_MAX:.0%} throttle and {p.thrust.voltage_nominal_v:g} V; "
        "expected a curve of all rotors together in N, and masses in kg"
    )


def _mass_ratio(p: Parameters) -> str | None:
    ratio = p.payload.mass_kg / p.vehicle.mass_kg
    load = f"the load of {p.payload.mass_kg:g} kg is {ratio:.3g} of the vehicle's {p.vehicle.mass_kg:g} kg"
    if ratio < MASS_RATIO_MIN:
        return f"{load}; expected at least {MASS_RATIO_MIN:g}, or its pull is lost in the accelerometer's noise"
    if ratio > MASS_RATIO_MAX:
        return f"{load}; expected at most {MASS_RATIO_MAX:g}: are both in kg?"
    return None


def _cable(p: Parameters) -> str | None:
    swing = swing_free(p)
    steps = p.estimator.rate_hz / swing.frequency_hz
    if steps >= STEPS_PER_SWING_MIN:
        return None
    return (
        f"on {p.cable.length_m:g} m the load swings at {swing.frequency_hz:.2f} Hz, {steps:.1f} filter steps per "
        f"period at {p.estimator.rate_hz:g} Hz; expected at least {STEPS_PER_SWING_MIN:g}: a longer cable, a lighter "
        "load, or a higher estimator.rate_hz"
    )


def _imu_rate(p: Parameters) -> str | None:
    if p.link.imu_rate_hz >= p.estimator.rate_hz:
        return None
    return (
        f"link.imu_rate_hz of {p.link.imu_rate_hz:g} Hz cannot feed estimator.rate_hz of {p.estimator.rate_hz:g} Hz; "
        "expected at least that rate, 200 to 250 Hz on a PX4"
    )


def _report_rate(p: Parameters) -> str | None:
    if p.link.report_rate_hz <= p.estimator.rate_hz:
        return None
    return (
        f"link.report_rate_hz is {p.link.report_rate_hz:g} Hz; expected at most estimator.rate_hz, "
        f"{p.estimator.rate_hz:g} Hz"
    )


def _battery(p: Parameters) -> str | None:
    if p.simulation.battery_empty_v <= p.simulation.battery_full_v:
        return None
    return (
        f"simulation.battery_empty_v is {p.simulation.battery_empty_v:g} V; expected at most "
        f"simulation.battery_full_v, {p.simulation.battery_full_v:g} V"
    )


def _url(url: str) -> str | None:
    try:
        parse_url(url)
    except LinkUrlError as error:
        return str(error)
    return None


LINKS = ("link.autopilot", *(f"endpoints.{place}.url" for place in range(1, LIST_MAX + 1)))
"""The links of the daemon by their keys: the autopilot's, then those of the endpoints."""


def _link_url(p: Parameters, link: int) -> str | None:
    """Give the URL of `LINKS` [link]; None if there are not as many endpoints."""
    return (p.link.autopilot, *(endpoint.url for endpoint in p.endpoints), *[None] * LIST_MAX)[link]


def _endpoint(link: int, p: Parameters) -> str | None:
    url = _link_url(p, link)
    return None if url is None else _url(url)


def _taken(url: str | None) -> str | None:
    """Name what only one link can have; None if there is no such thing."""
    if url is None or _url(url) is not None:
        return None
    return taken_by(parse_url(url, default_host=LOOPBACK))


def _same(first: int, second: int, p: Parameters) -> str | None:
    url = _link_url(p, second)
    taken = _taken(url)
    if taken is None or taken != _taken(_link_url(p, first)):
        return None
    return f"{url} takes {taken}, as {LINKS[first]} does; expected one of its own"


CHECKS = (
    Check(("thrust.voltage_nominal_v", "thrust.voltage_min_v", "thrust.voltage_max_v"), _voltages),
    Check(("thrust.motor_output_min", "thrust.motor_output_max"), _motor_outputs),
    Check(("thrust.quadratic_n", "thrust.linear_n", "thrust.offset_n"), _curve),
    Check(
        (
            "thrust.quadratic_n",
            "thrust.linear_n",
            "thrust.offset_n",
            "thrust.source",
            "thrust.voltage_nominal_v",
            "vehicle.mass_kg",
            "payload.mass_kg",
        ),
        _hover,
    ),
    Check(("payload.mass_kg", "vehicle.mass_kg"), _mass_ratio),
    Check(("cable.length_m", "vehicle.mass_kg", "payload.mass_kg", "estimator.rate_hz"), _cable),
    Check(("disturbance.feed_forward", "disturbance.source", "thrust.source"), _disturbance),
    Check(("waypoints", "mode", "path.source"), _waypoints),
    Check(("thrust.source", "mode"), _path_thrust),
    Check(("camera.source", "estimator.name"), _camera),
    Check(("thrust.source", "estimator.name"), _gp_ekf_thrust),
    Check(("link.autopilot",), lambda p: _url(p.link.autopilot)),
    *(Check((LINKS[link],), partial(_endpoint, link)) for link in range(1, len(LINKS))),
    *(
        Check((LINKS[second], LINKS[first]), partial(_same, first, second))
        for first, second in itertools.combinations(range(len(LINKS)), 2)
    ),
    Check(("link.imu_rate_hz", "estimator.rate_hz"), _imu_rate),
    Check(("link.report_rate_hz", "estimator.rate_hz"), _report_rate),
    Check(("simulation.mavlink",), lambda p: _url(p.simulation.mavlink)),
    Check(
        ("simulation.ground_station",),
        lambda p: None if p.simulation.ground_station == "none" else _url(p.simulation.ground_station),
    ),
    Check(("simulation.battery_empty_v", "simulation.battery_full_v"), _battery),
)
"""Every check, in the order of their first keys."""
