"""A configuration that is read again: what of it holds at once."""

from dataclasses import replace
from pathlib import Path

import pytest

from swingd.config.loader import load_parameters
from swingd.engine import Engine
from swingd.model.actions import StatusText
from swingd.model.errors import ConfigurationError
from swingd.model.ground_parameters import BY_KEY
from swingd.model.parameters import Endpoint, Mode, Parameters, ShaperName
from swingd.service.reload import Change, read_configuration
from swingd.service.state import StateFile

TWO = (Endpoint(url="udpin://127.0.0.1:14541"), Endpoint(url="udpin://127.0.0.1:14542"))


def test_it_is_read_as_at_the_start_with_the_command_lines_values(tmp_path: Path) -> None:
    file = tmp_path / "drone.yaml"
    file.write_text("payload: {mass_kg: 0.4}\n", encoding="utf-8")
    overrides = ["cable.length_m=2.5"]
    assert read_configuration(file, overrides) == load_parameters(file, overrides)
    assert read_configuration(None, []) == Parameters()


def test_a_wrong_one_is_refused_with_all_its_problems(tmp_path: Path) -> None:
    file = tmp_path / "drone.yaml"
    file.write_text("payload: {mass_kg: heavy}\ncable: {length_m: 0}\n", encoding="utf-8")
    with pytest.raises(ConfigurationError) as refused:
        read_configuration(file, [])
    with pytest.raises(ConfigurationError) as refused_at_start:
        load_parameters(file, [])
    assert str(refused.value) == str(refused_at_start.value)
    with pytest.raises(ConfigurationError, match=r"gone\.yaml"):
        read_configuration(tmp_path / "gone.yaml", [])


def test_nothing_changed_is_nothing_to_do() -> None:
    change = Change.between(Parameters(endpoints=TWO), Parameters(endpoints=TWO))
    assert (change.taken, change.waiting) == ((), ())


@pytest.mark.parametrize(
    "keys",
    [
        {"mode": Mode.HOLD},
        {"payload": replace(Parameters().payload, mass_kg=0.7)},
        {"control": replace(Parameters().control, law="payload", fade_out_s=0.2)},
        {"estimator": replace(Parameters().estimator, name="fgdf", rate_hz=50.0)},
        {"link": replace(Parameters().link, imu_rate_hz=200.0, report_rate_hz=5.0)},
        {"endpoints": (TWO[0], replace(TWO[1], shaper=ShaperName.ZV))},
    ],
    ids=lambda keys: next(iter(keys)),
)
def test_what_the_pipeline_takes_holds_at_once(keys: dict[str, object]) -> None:
    new = replace(Parameters(endpoints=TWO), **keys)  # type: ignore[arg-type]
    change = Change.between(Parameters(endpoints=TWO), new)
    assert change.parameters == new
    assert change.waiting == ()
    assert all(key.split(".")[0] == next(iter(keys)) for key in change.taken)
    engine = Engine(Parameters(endpoints=TWO))
    engine.join(0.0)
    engine.change_parameters(1.0, change.parameters, "")
    assert engine.pipeline.parameters == new


@pytest.mark.parametrize(
    ("keys", "waiting"),
    [
        ({"link": replace(Parameters().link, autopilot="udpin://0.0.0.0:14550")}, ("link.autopilot",)),
        ({"link": replace(Parameters().link, system_id=3, component_id=7)}, ("link.system_id", "link.component_id")),
        ({"link": replace(Parameters().link, key_file="/etc/swingd/key")}, ("link.key_file",)),
        ({"link": replace(Parameters().link, rc_channel=7)}, ("link.rc_channel",)),
        ({"endpoints": TWO[:1]}, ("endpoints",)),
        ({"endpoints": (TWO[0], replace(TWO[1], url="udpin://127.0.0.1:1"))}, ("endpoints.2.url",)),
        ({"endpoints": (TWO[0], replace(TWO[1], system_ids=(9,)))}, ("endpoints.2.system_ids",)),
    ],
)
def test_links_wait_for_a_restart_and_the_rest_does_not_wait_for_them(
    keys: dict[str, object], waiting: tuple[str, ...]
) -> None:
    now = Parameters(endpoints=TWO)
    new = replace(now, payload=replace(now.payload, mass_kg=0.7), **keys)  # type: ignore[arg-type]
    change = Change.between(now, new)
    assert change.waiting == waiting
    assert change.taken == ("payload.mass_kg",)
    assert change.parameters == replace(now, payload=new.payload)


def test_what_is_simulated_is_nothing_to_the_daemon() -> None:
    now = Parameters()
    change = Change.between(now, replace(now, simulation=replace(now.simulation, seed=7)))
    assert (change.taken, change.waiting) == ((), ())


def test_what_a_ground_station_set_stays_until_the_configuration_says_otherwise(tmp_path: Path) -> None:
    notes: list[StatusText] = []
    state = StateFile(Path("/etc/swingd/drone.yaml"), notes.append, tmp_path)
    damping = BY_KEY["control.damping_ratio"]
    configured = Parameters()
    parameters, _ = state.apply(configured)
    state.store(damping.put(parameters, 0.4), damping)

    heavier = replace(configured, payload=replace(configured.payload, mass_kg=0.7))
    again, told = state.reconfigure(heavier)
    assert (again.payload.mass_kg, again.control.damping_ratio) == (0.7, 0.4)
    assert ["as set by a ground station" in note.text for note in told] == [True]

    again, told = state.reconfigure(damping.put(heavier, 0.6))
    assert again.control.damping_ratio == 0.6
    assert ["which counts" in note.text for note in told] == [True]
    state.close()
    parameters, _ = StateFile(Path("/etc/swingd/drone.yaml"), notes.append, tmp_path).apply(configured)
    assert parameters.control.damping_ratio == configured.control.damping_ratio, "it is forgotten"
    assert notes == []
