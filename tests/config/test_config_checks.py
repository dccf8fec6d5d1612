"""Values that are allowed one by one and do not go together."""

import pytest

from swingd.config.checks import CHECKS
from swingd.config.loader import load_parameters
from swingd.config.schema import LIST_MAX, Key, find
from swingd.link.url import FORMS
from swingd.model.errors import ConfigurationError
from swingd.model.parameters import Parameters


def problem_of(*overrides: str) -> str:
    with pytest.raises(ConfigurationError) as caught:
        load_parameters(None, overrides)
    head, *lines = str(caught.value).split("\n  ")
    assert head == "configuration: 1 problem"
    assert len(lines) == 1
    return lines[0]


def test_the_defaults_go_together() -> None:
    assert [check.find(Parameters()) for check in CHECKS] == [None] * len(CHECKS)


def test_checks_name_existing_keys() -> None:
    assert all(isinstance(find(name.split(".")), Key) for check in CHECKS for name in check.keys)


@pytest.mark.parametrize(
    ("overrides", "problem"),
    [
        (
            ["thrust.voltage_nominal_v=6"],
            "thrust.voltage_nominal_v (--set): thrust.voltage_nominal_v is 6 V; expected it between "
            "thrust.voltage_min_v, 6 V, and thrust.voltage_max_v, 60 V, or every reading near it is refused",
        ),
        (
            ["thrust.voltage_max_v=16.2"],
            "thrust.voltage_max_v (--set): thrust.voltage_nominal_v is 16.2 V; expected it between "
            "thrust.voltage_min_v, 6 V, and thrust.voltage_max_v, 16.2 V, or every reading near it is refused",
        ),
        (
            ["thrust.motor_output_max=1000"],
            "thrust.motor_output_max (--set): thrust.motor_output_min and thrust.motor_output_max are both 1000; "
            "expected the outputs at zero and at full throttle, 1000 and 2000 for PWM",
        ),
        (
            ["thrust.offset_n=-0.1"],
            "thrust.offset_n (--set): the curve gives -0.1 N at zero throttle; expected thrust.offset_n of 0 or more",
        ),
        (
            ["thrust.linear_n=-2"],
            "thrust.linear_n (--set): the curve falls at zero throttle by 2 N per unit; expected thrust.linear_n of "
            "0 or more",
        ),
        (
            ["thrust.quadratic_n=-25", "thrust.linear_n=40"],
            "thrust.quadratic_n (--set): the curve falls again above 80% throttle; expected thrust.quadratic_n of at "
            "least -thrust.linear_n / 2 = -20 N",
        ),
        (
            ["thrust.quadratic_n=-1", "thrust.linear_n=0"],
            "thrust.quadratic_n (--set): the curve falls again above 0% throttle; expected thrust.quadratic_n of at "
            "least -thrust.linear_n / 2 = 0 N",
        ),
        (
            ["thrust.quadratic_n=0", "thrust.linear_n=0"],
            "thrust.quadratic_n (--set): the curve does not rise with the throttle; expected thrust.quadratic_n + "
            "thrust.linear_n above 0 N",
        ),
        (
            ["payload.mass_kg=2.2"],
            "payload.mass_kg (--set): 2 kg with a load of 2.2 kg need 41.2 N to hover, but the curve gives 40.5 N at "
            "95% throttle and 16.2 V; expected a curve of all rotors together in N, and masses in kg",
        ),
        (
            ["payload.mass_kg=0.009"],
            "payload.mass_kg (--set): the load of 0.009 kg is 0.0045 of the vehicle's 2 kg; expected at least 0.005, "
            "or its pull is lost in the accelerometer's noise",
        ),
        (
            ["payload.mass_kg=5", "thrust.quadratic_n=1000"],
            "payload.mass_kg (--set): the load of 5 kg is 2.5 of the vehicle's 2 kg; expected at most 2: are both in "
            "kg?",
        ),
        (
            ["cable.length_m=0.2", "estimator.rate_hz=20", "link.report_rate_hz=20"],
            "cable.length_m (--set): on 0.2 m the load swings at 1.20 Hz, 16.7 filter steps per period at 20 Hz; "
            "expected at least 20: a longer cable, a lighter load, or a higher estimator.rate_hz",
        ),
        (
            ["link.autopilot=udpin:0.0.0.0:14540"],
            "link.autopilot (--set): link URL 'udpin:0.0.0.0:14540': no '://'; expected one of " + FORMS,
        ),
        (
            ["simulation.mavlink=udp4://127.0.0.1:14540"],
            "simulation.mavlink (--set): link URL 'udp4://127.0.0.1:14540': unknown scheme 'udp4'; expected one of "
            + FORMS,
        ),
        (
            ["link.imu_rate_hz=50"],
            "link.imu_rate_hz (--set): link.imu_rate_hz of 50 Hz cannot feed estimator.rate_hz of 100 Hz; expected at "
            "least that rate, 200 to 250 Hz on a PX4",
        ),
        (
            ["link.report_rate_hz=101"],
            "link.report_rate_hz (--set): link.report_rate_hz is 101 Hz; expected at most estimator.rate_hz, 100 Hz",
        ),
        (
            ["simulation.battery_empty_v=17"],
            "simulation.battery_empty_v (--set): simulation.battery_empty_v is 17 V; expected at most "
            "simulation.battery_full_v, 16.2 V",
        ),
        (
            ["mode=path"],
            "mode (--set): mode path leads the load through waypoints and there are none; expected one, such as "
            "[{north_m: 20}]",
        ),
        (
            ["mode=path", "waypoints=[{north_m: 20}, {east_m: 5}, {east_m: 5}]"],
            "waypoints (--set): waypoint 3 is 0 m from the one before; expected at least 0.01 m",
        ),
        (
            ["mode=path", "waypoints=[{north_m: 20}]", "thrust.source=remark_1"],
            "thrust.source (--set): thrust.source remark_1 takes the thrust from the load's weight, which leaves no "
            "disturbance to be seen; mode path expects motors, throttle or auto",
        ),
        (
            ["endpoints=[{}, {url: 'udpin:14550'}]"],
            "endpoints.2.url (--set): link URL 'udpin:14550': no '://'; expected one of " + FORMS,
        ),
        (
            ["endpoints=[{url: 'udpin://:14540'}]"],
            "endpoints.1.url (--set): udpin://:14540 takes UDP port 14540, as link.autopilot does; "
            "expected one of its own",
        ),
        (
            ["endpoints=[{}, {}]"],
            "endpoints.2.url (--set): udpin://127.0.0.1:14541 takes UDP port 14541, as endpoints.1.url does; "
            "expected one of its own",
        ),
        (
            ["endpoints=[{url: 'tcpin://:5760'}, {}, {url: 'tcpin://[::1]:5760'}]"],
            "endpoints.3.url (--set): tcpin://[::1]:5760 takes TCP port 5760, as endpoints.1.url does; "
            "expected one of its own",
        ),
        (
            [
                "link.autopilot=serial:///dev/ttyACM0:57600",
                "endpoints.1.url=serial_flowcontrol:///dev/ttyACM0:921600",
            ],
            "endpoints.1.url (--set): serial_flowcontrol:///dev/ttyACM0:921600 takes /dev/ttyACM0, as link.autopilot "
            "does; expected one of its own",
        ),
    ],
)
def test_what_is_said_about_values_that_do_not_go_together(overrides: list[str], problem: str) -> None:
    assert problem_of(*overrides) == problem


@pytest.mark.parametrize(
    "overrides",
    [
        ["thrust.motor_output_min=2000", "thrust.motor_output_max=1000"],  # reversed outputs
        ["thrust.quadratic_n=0", "thrust.linear_n=36", "thrust.offset_n=0"],
        ["thrust.quadratic_n=36", "thrust.linear_n=0", "thrust.offset_n=0"],
        ["thrust.quadratic_n=-20", "thrust.linear_n=60"],
        ["payload.mass_kg=0.01"],
        ["vehicle.mass_kg=1.0", "payload.mass_kg=2.0"],
        ["link.imu_rate_hz=100"],
        ["link.report_rate_hz=100"],
        ["simulation.battery_empty_v=16.2"],
        ["endpoints=[{url: 'udpin://:14550'}, {url: 'tcpin://:14550'}, {url: 'udpout://127.0.0.1:14550'}]"],
        ["endpoints=[{url: 'udpin://:0'}, {url: 'udpin://:0'}, {url: 'tcpin://:0'}, {url: 'tcpin://:0'}]"],
        ["endpoints=[{url: 'udpout://host:14550'}, {url: 'udpout://host:14550'}]"],
        ["endpoints=[{url: 'serial:///dev/ttyS0:57600'}, {url: 'serial:///dev/ttyS1:57600'}]"],
    ],
)
def test_what_is_on_the_border_is_accepted(overrides: list[str]) -> None:
    assert load_parameters(None, overrides) != Parameters()


def test_without_a_thrust_stream_the_curve_need_not_carry_the_load() -> None:
    heavy = ["vehicle.mass_kg=5"]
    assert problem_of(*heavy).startswith("vehicle.mass_kg (--set): 5 kg with a load of 0.3 kg need 52.0 N to hover")
    assert load_parameters(None, [*heavy, "thrust.source=remark_1"]).vehicle.mass_kg == 5.0


def test_two_things_that_are_wrong_with_one_value_are_both_said() -> None:
    with pytest.raises(ConfigurationError) as caught:
        load_parameters(None, ["payload.mass_kg=5"])
    head, hover, ratio = str(caught.value).split("\n  ")
    assert head == "configuration: 2 problems"
    assert "need 68.6 N to hover" in hover
    assert "is 2.5 of the vehicle's 2 kg" in ratio


def test_each_of_the_most_endpoints_is_checked() -> None:
    urls = [f"udpin://:{port}" for port in range(15_001, 15_001 + LIST_MAX)]
    listed = ", ".join(f"{{url: '{url}'}}" for url in urls)
    assert [endpoint.url for endpoint in load_parameters(None, [f"endpoints=[{listed}]"]).endpoints] == urls
    last = f"endpoints.{LIST_MAX}.url"
    assert problem_of(f"endpoints=[{listed}]", f"{last}=udpin://0.0.0.0:15003").startswith(
        f"{last} (--set): udpin://0.0.0.0:15003 takes UDP port 15003, as endpoints.3.url does"
    )
    assert problem_of(f"endpoints=[{listed}]", f"{last}=x").startswith(f"{last} (--set): link URL 'x': no '://'")
