import json
import os
import signal
import subprocess
import sys
import threading
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from swingd.model.actions import Severity, StatusText
from swingd.model.ground_parameters import BY_NAME, GROUND_PARAMETERS
from swingd.model.parameters import Parameters
from swingd.service.state import BYTES_MAX, StateFile, state_folder

CABLE, ENABLE, MASS = BY_NAME["SWG_CABLE_LEN"], BY_NAME["SWG_ENABLE"], BY_NAME["SWG_LOAD_MASS"]


class Notes(list[StatusText]):
    """What the writer has told, from its thread."""

    def __call__(self, note: StatusText) -> None:
        self.append(note)


def with_cable(length_m: float, base: Parameters | None = None) -> Parameters:
    return CABLE.put(base or Parameters(), length_m)


def opened(folder: Path, configuration: str | None = "/etc/swingd/drone.yaml", notes: Notes | None = None) -> StateFile:
    return StateFile(
        None if configuration is None else Path(configuration), Notes() if notes is None else notes, folder
    )


def stored(folder: Path, parameters: Parameters, *changed, configured: Parameters | None = None) -> Path:
    """Store as a run of the daemon does; give the file."""
    notes = Notes()
    state = opened(folder, notes=notes)
    state.apply(configured or Parameters())
    state.store(parameters, *changed)
    state.close()
    assert notes == []
    assert state.path is not None
    return state.path


def test_values_survive_a_restart(tmp_path):
    parameters = ENABLE.put(with_cable(2.4), 0.0)
    stored(tmp_path / "not" / "there", parameters, CABLE, ENABLE)
    again, notes = opened(tmp_path / "not" / "there").apply(Parameters())
    assert again == parameters
    assert notes == (
        StatusText(Severity.NOTICE, "SWG_CABLE_LEN: 2.4 as set by a ground station, not 1.5 as configured"),
        StatusText(Severity.NOTICE, "SWG_ENABLE: 0 as set by a ground station, not 1 as configured"),
    )


@given(st.data())
def test_every_value_survives_exactly(tmp_path_factory, data):
    folder = tmp_path_factory.mktemp("state")
    chosen = data.draw(st.lists(st.sampled_from(GROUND_PARAMETERS), unique=True))
    parameters = Parameters()
    for parameter in chosen:
        allowed = st.sampled_from([0.0, 1.0]) if parameter.is_switch else st.floats(parameter.low, parameter.high)
        parameters = parameter.put(parameters, data.draw(allowed))
    stored(folder, parameters, *chosen)
    assert opened(folder).apply(Parameters())[0] == parameters


def test_nothing_is_kept_but_what_was_set(tmp_path):
    # A correction switched off by the pilot is no value that a ground station set.
    path = stored(tmp_path, ENABLE.put(with_cable(2.4), 0.0), CABLE)
    assert list(json.loads(path.read_text())["set_by_ground_station"]) == [CABLE.key]
    assert opened(tmp_path).apply(Parameters())[0] == with_cable(2.4)


def test_without_anything_stored_there_is_no_file_and_nothing_to_tell(tmp_path):
    state = opened(tmp_path)
    assert state.apply(with_cable(3.0)) == (with_cable(3.0), ())
    state.close()
    assert list(tmp_path.iterdir()) == []


def test_a_key_that_the_user_has_changed_since_wins_and_stays(tmp_path):
    # GIVEN two values set over MAVLink
    stored(tmp_path, MASS.put(with_cable(2.4), 0.5), CABLE, MASS)
    # WHEN the user changes one of them in the configuration, or with --set
    notes = Notes()
    state = opened(tmp_path, notes=notes)
    parameters, told = state.apply(with_cable(1.8))
    state.close()
    # THEN it counts, the other one is as it was set
    assert parameters == MASS.put(with_cable(1.8), 0.5)
    assert [note.text for note in told] == [
        "SWG_CABLE_LEN: 2.4 was set by a ground station when cable.length_m was 1.5; "
        "it now is 1.8 in the configuration, which counts",
        "SWG_LOAD_MASS: 0.5 as set by a ground station, not 0.3 as configured",
    ]
    # AND the value does not come back when the configuration does
    assert opened(tmp_path).apply(Parameters())[0] == MASS.put(Parameters(), 0.5)


def test_a_value_set_back_to_the_configuration_is_forgotten(tmp_path):
    path = stored(tmp_path, with_cable(2.4), CABLE)
    state = opened(tmp_path)
    state.apply(Parameters())
    state.store(Parameters(), CABLE)
    state.close()
    assert json.loads(path.read_text())["set_by_ground_station"] == {}


def test_values_of_earlier_runs_stay_when_others_are_set(tmp_path):
    stored(tmp_path, with_cable(2.4), CABLE)
    state = opened(tmp_path)
    parameters, _ = state.apply(Parameters())
    state.store(MASS.put(parameters, 0.7), MASS)
    state.close()
    assert opened(tmp_path).apply(Parameters())[0] == MASS.put(with_cable(2.4), 0.7)


def test_each_configuration_has_its_own(tmp_path):
    files = set()
    for configuration, length_m in (
        ("/a/drone.yaml", 2.0),
        ("/b/drone.yaml", 3.0),
        ("/a/other.yaml", 4.0),
        (None, 5.0),
    ):
        state = opened(tmp_path, configuration)
        assert state.apply(Parameters())[0] == Parameters()
        state.store(with_cable(length_m), CABLE)
        state.close()
        files.add(state.path)
    assert len(files) == 4
    assert opened(tmp_path, "/b/drone.yaml").apply(Parameters())[0] == with_cable(3.0)
    assert opened(tmp_path, None).apply(Parameters())[0] == with_cable(5.0)


def test_a_configuration_is_known_by_its_absolute_path(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert opened(tmp_path, "drone.yaml").path == opened(tmp_path, str(tmp_path / "drone.yaml")).path


def test_a_file_with_a_long_and_strange_name_has_its_own_too(tmp_path):
    state = opened(tmp_path, "/" + "ä" * 300 + "\udcff.yaml")
    state.apply(Parameters())
    state.store(with_cable(2.0), CABLE)
    state.close()
    assert state.path is not None
    assert state.path.exists()


# ------------------------------------------------------------------------------------------------- damage

ENTRY = {"value": 2.4, "configured": 1.5}


def file_with(folder: Path, content: bytes | str | dict) -> None:
    path = opened(folder).path
    assert path is not None
    if isinstance(content, dict):
        content = json.dumps({"format": 1, "configuration": "x", "set_by_ground_station": content})
    path.write_bytes(content.encode() if isinstance(content, str) else content)


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"{",
        b"\x00\xff\xfe",
        "[]",
        "{}",
        '{"format": 2, "set_by_ground_station": {}}',
        '{"format": 1}',
        '{"format": 1, "set_by_ground_station": 7}',
        "[" * 100_000,
        b" " * (BYTES_MAX + 1),
        '{"format": 1, "set_by_ground_station": {"cable.length_m": {"value": 2.4, "confi',
    ],
    ids=lambda content: repr(content[:20]),
)
def test_a_damaged_file_is_told_and_the_configuration_counts(tmp_path, content):
    file_with(tmp_path, content)
    state = opened(tmp_path)
    parameters, notes = state.apply(with_cable(1.8))
    assert parameters == with_cable(1.8)
    (note,) = notes
    assert note.severity is Severity.WARNING
    assert note.text.startswith(f"state file {state.path} is damaged and is not used: ")
    # The next value makes it whole again.
    state.store(with_cable(2.0), CABLE)
    state.close()
    assert opened(tmp_path).apply(with_cable(1.8))[0] == with_cable(2.0)


@pytest.mark.parametrize(
    ("key", "item"),
    [
        ("cable.length_m", {"value": 1e6, "configured": 1.5}),
        ("cable.length_m", {"value": 0.0, "configured": 1.5}),
        ("cable.length_m", {"value": "2", "configured": 1.5}),
        ("cable.length_m", {"value": True, "configured": 1.5}),
        ("cable.length_m", {"value": None, "configured": 1.5}),
        ("cable.length_m", {"value": float("nan"), "configured": 1.5}),
        ("cable.length_m", {"value": float("inf"), "configured": 1.5}),
        ("cable.length_m", {"value": 10**400, "configured": 1.5}),
        ("cable.length_m", {"value": 2.0}),
        ("cable.length_m", [2.0, 1.5]),
        ("control.enabled", {"value": 0, "configured": True}),
        ("control.enabled", {"value": False, "configured": 1.0}),
        ("cable.width_m", {"value": 2.0, "configured": 1.5}),
        ("link.autopilot", {"value": "tcpout://evil:1", "configured": "udpin://0.0.0.0:14540"}),
        ("estimator.rate_hz", {"value": 20.0, "configured": 100.0}),
    ],
)
def test_an_entry_that_cannot_be_is_told_and_left_out_the_others_count(tmp_path, key, item):
    file_with(tmp_path, {key: item, "payload.mass_kg": {"value": 0.5, "configured": 0.3}})
    parameters, notes = opened(tmp_path).apply(Parameters())
    assert parameters == MASS.put(Parameters(), 0.5)
    assert [note.severity for note in notes] == [Severity.WARNING, Severity.NOTICE]
    assert key in notes[0].text or BY_NAME["SWG_CABLE_LEN"].name in notes[0].text


@given(
    st.recursive(
        st.none() | st.booleans() | st.floats() | st.text(),
        lambda inner: (
            st.lists(inner)
            | st.dictionaries(
                st.sampled_from(["format", "set_by_ground_station", "cable.length_m", "value", "configured"])
                | st.text(),
                inner,
            )
        ),
    )
)
def test_any_json_is_borne(tmp_path_factory, content):
    folder = tmp_path_factory.mktemp("state")
    file_with(folder, json.dumps(content))
    assert opened(folder).apply(Parameters())[0] == Parameters()


def test_a_rest_of_an_interrupted_write_disturbs_nothing(tmp_path):
    # GIVEN a process that was killed between the write and the renaming
    path = stored(tmp_path, with_cable(2.4), CABLE)
    rest = path.with_name(path.name + ".new")
    rest.write_bytes(b'{"format": 1, "set_by_gro')
    # THEN the values before it count
    state = opened(tmp_path)
    assert state.apply(Parameters())[0] == with_cable(2.4)
    # AND the next write takes its place
    state.store(with_cable(2.5), CABLE)
    state.close()
    assert list(tmp_path.iterdir()) == [path]
    assert opened(tmp_path).apply(Parameters())[0] == with_cable(2.5)


KILLED = """
import os, sys, signal
from pathlib import Path
from swingd.model.ground_parameters import BY_NAME
from swingd.model.parameters import Parameters
from swingd.service.state import StateFile

cable = BY_NAME["SWG_CABLE_LEN"]
state = StateFile(Path("/etc/swingd/drone.yaml"), print, Path(sys.argv[1]))
parameters, _ = state.apply(Parameters())
print("begun", flush=True)
length_m = 2.0
while True:
    length_m = 2.0 if length_m > 100.0 else length_m + 0.125
    state.store(cable.put(parameters, length_m), cable)
"""


def test_a_process_that_is_killed_at_any_time_leaves_a_whole_file(tmp_path):
    stored(tmp_path, with_cable(2.0), CABLE)
    for round_ in range(5):
        with subprocess.Popen([sys.executable, "-c", KILLED, str(tmp_path)], stdout=subprocess.PIPE) as process:
            assert process.stdout is not None
            assert process.stdout.readline() == b"begun\n"
            threading.Event().wait(0.02 + 0.013 * round_)
            process.send_signal(signal.SIGKILL)
        parameters, notes = opened(tmp_path).apply(Parameters())
        assert 2.0 <= parameters.cable.length_m <= 100.2
        assert [note.severity for note in notes] == [Severity.NOTICE]


# ------------------------------------------------------------------------------------- what cannot be written


def lost(notes: Notes) -> bool:
    return [note.severity for note in notes] == [Severity.WARNING] and "what was set is lost" in notes[0].text


UNWRITABLE = """
import os, tempfile
from pathlib import Path
from swingd.model.ground_parameters import BY_NAME
from swingd.model.parameters import Parameters
from swingd.service.state import StateFile

cable = BY_NAME["SWG_CABLE_LEN"]
with tempfile.TemporaryDirectory() as folder:
    os.chmod(folder, 0o555)
    root = os.geteuid() == 0
    state = StateFile(Path("/etc/swingd/drone.yaml"), lambda note: print(note.severity.name, note.text), Path(folder))
    state.apply(Parameters())
    if root:
        os.seteuid(65534)
    state.store(cable.put(Parameters(), 2.0), cable)
    state.close()
    if root:
        os.seteuid(0)
    os.chmod(folder, 0o755)
"""


def test_a_folder_that_may_not_be_written_is_told():
    done = subprocess.run([sys.executable, "-c", UNWRITABLE], capture_output=True, text=True, check=True, timeout=60)
    assert done.stdout.startswith("WARNING state file ")
    assert "cannot be written: Permission denied; what was set is lost at the next start" in done.stdout


def test_a_folder_that_cannot_be_made_is_told_and_tried_again_at_the_end(tmp_path):
    blocked = tmp_path / "file"
    blocked.write_text("no folder")
    notes = Notes()
    state = opened(blocked / "state", notes=notes)
    assert state.apply(Parameters())[0] == Parameters()
    state.store(with_cable(2.0), CABLE)
    state.close()
    assert lost(Notes(notes[:1]))
    # WHEN the obstacle is gone
    blocked.unlink()
    state.close()
    # THEN what stayed in memory is written
    assert opened(blocked / "state").apply(Parameters())[0] == with_cable(2.0)


def test_a_file_that_cannot_be_read_is_told(tmp_path):
    path = opened(tmp_path).path
    assert path is not None
    path.mkdir()
    state = opened(tmp_path)
    parameters, notes = state.apply(Parameters())
    assert parameters == Parameters()
    assert [note.text for note in notes] == [f"state file {path} cannot be read: Is a directory"]


def test_a_link_in_the_place_of_the_new_file_is_not_followed(tmp_path):
    path = stored(tmp_path, with_cable(2.4), CABLE)
    victim = tmp_path / "victim"
    victim.write_text("untouched")
    path.with_name(path.name + ".new").symlink_to(victim)
    notes = Notes()
    state = opened(tmp_path, notes=notes)
    state.apply(Parameters())
    state.store(with_cable(2.5), CABLE)
    state.close()
    assert victim.read_text() == "untouched"
    assert lost(Notes(notes[:1]))


FULL = """
import resource, sys
from pathlib import Path
from swingd.model.ground_parameters import GROUND_PARAMETERS
from swingd.model.parameters import Parameters
from swingd.service.state import StateFile

notes = []
state = StateFile(Path("/etc/swingd/drone.yaml"), notes.append, Path(sys.argv[1]))
configured, _ = state.apply(Parameters())
parameters = configured
for parameter in GROUND_PARAMETERS:
    parameters = parameter.put(parameters, parameter.low)
resource.setrlimit(resource.RLIMIT_FSIZE, (512, resource.RLIM_INFINITY))
state.store(parameters, *GROUND_PARAMETERS)
state.close()
print(len(notes), notes[0].severity.name, notes[0].text)
resource.setrlimit(resource.RLIMIT_FSIZE, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
state.close()
print(len(notes))
"""


def test_a_disk_without_room_is_told_keeps_the_old_file_and_gets_the_new_one_when_there_is(tmp_path):
    path = stored(tmp_path, with_cable(2.4), CABLE)
    before = path.read_bytes()
    half = FULL.partition("resource.setrlimit(resource.RLIMIT_FSIZE, (resource.RLIM_INF")[0]
    for script, notes_told in ((half, 1), (FULL, None)):
        done = subprocess.run(
            [sys.executable, "-c", script, str(tmp_path)], capture_output=True, text=True, check=True, timeout=60
        )
        assert "WARNING state file" in done.stdout
        assert "File too large; what was set is lost at the next start" in done.stdout
        if notes_told:
            assert path.read_bytes() == before
            assert list(tmp_path.iterdir()) == [path]
    parameters, _ = opened(tmp_path).apply(Parameters())
    assert [p.get(parameters) for p in GROUND_PARAMETERS] == [p.low for p in GROUND_PARAMETERS]


def test_storing_does_not_wait_for_the_disk_and_the_last_value_wins(tmp_path):
    # GIVEN a disk that does not answer: a reader that never comes to a named pipe
    path = stored(tmp_path, with_cable(2.4), CABLE)
    pipe = path.with_name(path.name + ".new")
    os.mkfifo(pipe)
    state = opened(tmp_path)
    state.apply(Parameters())
    # WHEN values come meanwhile
    for length_m in (2.0, 3.0, 4.0):
        state.store(with_cable(length_m), CABLE)
    assert opened(tmp_path).apply(Parameters())[0] == with_cable(2.4)
    # AND it answers at last
    reader = os.open(pipe, os.O_RDONLY)
    try:
        state.close()
    finally:
        os.close(reader)
    # THEN what was set last is on it
    assert opened(tmp_path).apply(Parameters())[0] == with_cable(4.0)


def test_many_values_in_a_row_end_with_the_last(tmp_path):
    state = opened(tmp_path)
    state.apply(Parameters())
    for step in range(300):
        state.store(with_cable(2.0 + step / 8), CABLE)
    state.close(30.0)
    assert opened(tmp_path).apply(Parameters())[0] == with_cable(2.0 + 299 / 8)
    assert not [thread for thread in threading.enumerate() if thread.name == "swingd-state"]


def test_storing_before_reading_is_a_mistake_of_the_program(tmp_path):
    with pytest.raises(RuntimeError, match=r"after StateFile\.apply"):
        opened(tmp_path).store(Parameters(), CABLE)


# ----------------------------------------------------------------------------------------------- where it lies


def test_the_folder_is_systemd_s_then_that_of_the_user(monkeypatch, tmp_path):
    monkeypatch.setenv("STATE_DIRECTORY", "/var/lib/swingd:/var/lib/other")
    monkeypatch.setenv("XDG_STATE_HOME", "/home/pilot/state")
    assert state_folder() == Path("/var/lib/swingd")
    monkeypatch.delenv("STATE_DIRECTORY")
    assert state_folder() == Path("/home/pilot/state/swingd")
    monkeypatch.setenv("XDG_STATE_HOME", "relative")
    monkeypatch.setenv("HOME", str(tmp_path))
    assert state_folder() == tmp_path / ".local" / "state" / "swingd"
    monkeypatch.delenv("XDG_STATE_HOME")
    assert StateFile(None, Notes()).path == tmp_path / ".local" / "state" / "swingd" / "default.json"


def test_without_a_home_it_is_told_and_goes_on(monkeypatch):
    for name in ("STATE_DIRECTORY", "XDG_STATE_HOME", "HOME"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(os, "getuid", lambda: 4_000_000)  # nobody of whom the system knows a home
    notes = Notes()
    state = StateFile(None, notes)
    assert state.path is None
    parameters, told = state.apply(Parameters())
    assert parameters == Parameters()
    assert [note.severity for note in told] == [Severity.WARNING]
    state.store(with_cable(2.0), CABLE)
    state.close()
    assert lost(Notes(notes[:1]))


def test_only_the_owner_may_read_and_write(tmp_path):
    path = stored(tmp_path / "state", with_cable(2.4), CABLE)
    assert path.stat().st_mode & 0o777 == 0o600
    assert path.parent.stat().st_mode & 0o777 == 0o700


def test_it_is_read_without_anything_heavy():
    script = (
        "import sys, swingd.service.state;"
        "heavy = {'numpy', 'numba', 'pydantic', 'rich', 'structlog', 'yaml', 'asyncio'};"
        "print(sorted(heavy & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True, timeout=60)
    assert done.stdout == "[]\n"


def test_replace_of_other_groups_is_not_undone(tmp_path):
    stored(tmp_path, with_cable(2.4), CABLE)
    configured = replace(Parameters(), link=replace(Parameters().link, autopilot="tcpout://127.0.0.1:5760"))
    assert opened(tmp_path).apply(configured)[0] == with_cable(2.4, configured)
