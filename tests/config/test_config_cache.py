"""The light path: the same parameters, without the modules that take long to import."""

import json
import os
import shutil
import stat
import subprocess
import sys
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from parameter_strategies import parameter_sets

from swingd.config.cache import ENTRIES_MAX, load_cached
from swingd.config.loader import load_parameters
from swingd.config.plain import parameters_to_json, plain, restore
from swingd.config.schema import KEYS, value_of
from swingd.model.errors import ConfigurationError
from swingd.model.parameters import Endpoint, Mode, Parameters, ShaperName

ROOT = Path(__file__).resolve().parents[2]
HEAVY = ("pydantic", "pydantic_core", "yaml", "numpy", "numba", "rich", "structlog", "typer")
ENDPOINT = 'endpoints=[{url: "udpin://:14541", shaper: zv, system_ids: [1, 255]}]'


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder of the entries, which does not exist yet."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return tmp_path / "cache" / "swingd"


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "test.yaml"
    path.write_text("mode: hold\npayload: {mass_kg: 0.4}\n", encoding="utf-8")
    return path


def entries(cache: Path) -> list[Path]:
    return sorted(cache.iterdir())


def start(*arguments: Path | str, **environment: str) -> dict[str, Any]:
    """Load in a process of its own: what was loaded, and which heavy modules that took."""
    code = (
        "import json, sys\n"
        "from swingd.config.cache import load_cached\n"
        "from swingd.config.plain import plain\n"
        "found = load_cached(sys.argv[1], sys.argv[2:])\n"
        f"print(json.dumps({{'heavy': [m for m in {HEAVY} if m in sys.modules], 'found': plain(found)}}))\n"
    )
    result = subprocess.run(
        [sys.executable, "-P", "-c", code, *arguments],
        capture_output=True,
        text=True,
        check=True,
        timeout=60,
        env={**os.environ, **environment},
    )
    found: dict[str, Any] = json.loads(result.stdout)
    return found


# The same as the loader, faster


def test_the_second_start_loads_the_same_without_the_heavy_modules(cache: Path) -> None:
    path = ROOT / "configs" / "x500.yaml"
    first = start(path, ENDPOINT, "payload.mass_kg=0.3")
    second = start(path, ENDPOINT, "payload.mass_kg=0.3")
    assert set(first["heavy"]) >= {"pydantic", "yaml", "numpy"}
    assert second["heavy"] == []
    assert first["found"] == second["found"] == plain(load_parameters(path, [ENDPOINT, "payload.mass_kg=0.3"]))


def test_what_was_kept_is_what_the_loader_gives(cache: Path, file: Path) -> None:
    for overrides in ([], [ENDPOINT], ["control.enabled=false", "hold.vel_ned_mps=[1, 0, -0.0]"]):
        expected = load_parameters(file, overrides)
        first, second = load_cached(file, overrides), load_cached(file, overrides)
        assert first == second == expected
        for name in KEYS:
            assert repr(value_of(second, name)) == repr(value_of(expected, name))
    assert len(entries(cache)) == 3
    assert load_cached() == load_cached() == Parameters()


def test_another_content_or_override_has_its_own_entry(cache: Path, file: Path) -> None:
    assert load_cached(file).mode is Mode.HOLD
    assert load_cached(file, ["mode=inline"]).mode is Mode.INLINE
    assert load_cached(file, ["mode=inline", "mode=hold"]).mode is Mode.HOLD
    file.write_text("mode: shadow\n", encoding="utf-8")
    assert load_cached(file).mode is Mode.SHADOW
    assert load_cached(file, ["mode=inline"]).mode is Mode.INLINE
    assert len(entries(cache)) == 5


def test_the_same_content_elsewhere_needs_no_second_entry(cache: Path, file: Path) -> None:
    other = file.with_name("other.yaml")
    shutil.copy(file, other)
    assert load_cached(file) == load_cached(other)
    assert len(entries(cache)) == 1


def test_a_mistake_is_told_every_time_and_never_kept(cache: Path, file: Path) -> None:
    load_cached(file)
    for _ in range(2):
        with pytest.raises(ConfigurationError, match=r"payload.mass_kg \(--set\): -1 given; expected a number"):
            load_cached(file, ["payload.mass_kg=-1"])
        with pytest.raises(ConfigurationError, match="No such file or directory"):
            load_cached(file.with_name("no.yaml"))
    assert len(entries(cache)) == 1


def test_another_version_or_other_declarations_have_their_own_entry(cache: Path, file: Path, tmp_path: Path) -> None:
    copy = tmp_path / "copy" / "swingd"
    shutil.copytree(ROOT / "swingd", copy, ignore=shutil.ignore_patterns("__pycache__"))
    changes = {
        "__init__.py": ("__version__ = ", "__version__ = '9' + "),
        "model/parameters.py": ("0.005, 2000.0", "0.005, 2001.0"),
        "config/checks.py": ("HOVER_THROTTLE_MAX = 0.95", "HOVER_THROTTLE_MAX = 0.94"),
    }
    here = {"PYTHONPATH": str(copy.parent)}
    start(file, **here)
    assert start(file, **here)["heavy"] == []
    for name, (old, new) in changes.items():
        source = (copy / name).read_text(encoding="utf-8")
        assert old in source
        (copy / name).write_text(source.replace(old, new), encoding="utf-8")
        assert "pydantic" in start(file, **here)["heavy"]
        assert start(file, **here)["heavy"] == []
    assert len(entries(cache)) == 1 + len(changes)


def test_a_pipe_is_read_once(cache: Path, tmp_path: Path) -> None:
    """As the shell's ``-c <(generate)`` gives it."""
    for _ in range(2):
        read_end, write_end = os.pipe()
        os.write(write_end, b"mode: inline\n")
        os.close(write_end)
        assert load_cached(f"/dev/fd/{read_end}").mode is Mode.INLINE
        os.close(read_end)


# Nothing that was not written here is believed


def damages() -> dict[str, Callable[[Path], object]]:
    def rewrite(change: Callable[[bytes], bytes]) -> Callable[[Path], object]:
        return lambda entry: entry.write_bytes(change(entry.read_bytes()))

    def other_value(content: bytes) -> bytes:
        assert b'"mass_kg":0.4' in content
        return content.replace(b'"mass_kg":0.4', b'"mass_kg":0.5')

    return {
        "empty": rewrite(lambda content: b""),
        "cut": rewrite(lambda content: content[:-1]),
        "longer": rewrite(lambda content: content + b" "),
        "no checksum": rewrite(lambda content: content.partition(b"\n")[2]),
        "another value": rewrite(other_value),
        "binary": rewrite(lambda content: bytes(range(256))),
        "huge": rewrite(lambda content: content + b" " * 2**20),
        "writable for others": lambda entry: entry.chmod(0o666),
        "a folder": lambda entry: (entry.unlink(), entry.mkdir()),
        "a pipe": lambda entry: (entry.unlink(), os.mkfifo(entry)),
        "a link": lambda entry: (entry.rename(entry.with_suffix(".moved")), entry.symlink_to(f"{entry.stem}.moved")),
        "of another configuration": lambda entry: (
            load_cached(None, ["mode=inline"]),
            shutil.copy(next(other for other in entries(entry.parent) if other != entry), entry),
        ),
    }


@pytest.mark.parametrize("damage", damages().values(), ids=damages())
def test_a_damaged_entry_is_not_believed_and_renewed_where_possible(
    cache: Path, file: Path, damage: Callable[[Path], object]
) -> None:
    expected = load_cached(file)
    (entry,) = entries(cache)
    content = entry.read_bytes()
    damage(entry)
    assert load_cached(file) == expected
    if not entry.is_dir():
        assert entry.read_bytes() == content
        assert stat.S_IMODE(entry.lstat().st_mode) == 0o600
    assert load_cached(file) == expected


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.data())
def test_no_flipped_byte_is_believed(cache: Path, file: Path, data: st.DataObject) -> None:
    expected = load_cached(file)
    entry = entries(cache)[0]
    content = bytearray(entry.read_bytes())
    place = data.draw(st.integers(0, len(content) - 1))
    content[place] ^= data.draw(st.integers(1, 255))
    entry.write_bytes(content)
    assert load_cached(file) == expected


@pytest.mark.skipif(os.geteuid() != 0, reason="only root gives files away")
def test_an_entry_of_another_user_is_not_believed(cache: Path, file: Path) -> None:
    expected = load_cached(file)
    (entry,) = entries(cache)
    os.chown(entry, 65534, -1)
    assert load_cached(file) == expected
    assert entry.stat().st_uid == 0


# Without a place for it


@pytest.mark.parametrize("kind", ["a file", "below a file", "a device"])
def test_without_a_folder_to_write_it_loads_all_the_same(
    kind: str, tmp_path: Path, file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    blocked = tmp_path / "blocked"
    blocked.write_text("not a folder")
    places = {"a file": blocked, "below a file": blocked / "deeper", "a device": Path("/dev/null")}
    monkeypatch.setenv("XDG_CACHE_HOME", str(places[kind]))
    assert load_cached(file) == load_cached(file) == load_parameters(file)
    assert blocked.read_text() == "not a folder"


def test_a_folder_that_is_not_absolute_is_ignored(tmp_path: Path, file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As the XDG base directory specification asks for; nothing appears where the daemon happens to run."""
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    monkeypatch.setenv("XDG_CACHE_HOME", "relative")
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    assert load_cached(file).mode is Mode.HOLD
    assert list((tmp_path / "here").iterdir()) == []
    assert len(entries(tmp_path / "home" / ".cache" / "swingd")) == 1
    monkeypatch.setenv("HOME", "also-relative")
    assert load_cached(file).mode is Mode.HOLD
    assert list((tmp_path / "here").iterdir()) == []


# It keeps itself small


def test_entries_that_are_not_used_go(cache: Path, file: Path) -> None:
    load_cached(file)
    (kept,) = entries(cache)
    kernels = cache / "kernels-0000"
    kernels.mkdir()
    for index in range(ENTRIES_MAX + 5):
        load_cached(file, [f"simulation.seed={index}"])
        for age, entry in enumerate(sorted(cache.glob("configuration-*"), key=lambda path: path.stat().st_mtime_ns)):
            os.utime(entry, ns=(age * 10**9, age * 10**9))  # the clock of a file may not tell two of them apart
        load_cached(file)  # in use
    left = [entry for entry in entries(cache) if entry != kernels]
    assert len(left) == ENTRIES_MAX
    assert kept in left
    assert kernels.is_dir()


def test_two_that_write_at_once_leave_one_good_entry(cache: Path, file: Path) -> None:
    code = "import sys; from swingd.config.cache import load_cached; load_cached(sys.argv[1])"
    processes = [subprocess.Popen([sys.executable, "-c", code, str(file)]) for _ in range(3)]
    assert [process.wait(60) for process in processes] == [0, 0, 0]
    assert len(entries(cache)) == 1
    assert start(file)["heavy"] == []


# The decoder


@given(parameter_sets())
def test_plain_values_are_restored_bit_for_bit(parameters: Parameters) -> None:
    restored = restore(Parameters, json.loads(parameters_to_json(parameters)))
    for name in KEYS:
        assert repr(value_of(restored, name)) == repr(value_of(parameters, name))


def with_value(path: tuple[str | int, ...], value: object) -> dict[str, Any]:
    values = plain(Parameters(endpoints=(Endpoint(shaper=ShaperName.EI, system_ids=(1,)),)))
    holder: Any = values
    for part in path[:-1]:
        holder = holder[part]
    holder[path[-1]] = value
    return dict(values)


@pytest.mark.parametrize(
    ("path", "value"),
    [
        (("mode",), "fly"),
        (("mode",), None),
        (("mode",), []),
        (("payload",), None),
        (("payload",), {}),
        (("payload", "mass_kg"), 1),
        (("payload", "mass_kg"), True),
        (("payload", "mass_kg"), "0.3"),
        (("payload", "mass_kg"), float("nan")),
        (("payload", "mass_kg"), float("inf")),
        (("payload", "more"), 1.0),
        (("more",), 1.0),
        (("link", "system_id"), 1.0),
        (("link", "system_id"), False),
        (("link", "autopilot"), 14540),
        (("control", "enabled"), 1),
        (("hold", "vel_ned_mps"), [0.0, 0.0]),
        (("hold", "vel_ned_mps"), [0.0, 0.0, 0]),
        (("hold", "vel_ned_mps"), "abc"),
        (("endpoints",), None),
        (("endpoints",), {}),
        (("endpoints", 0), None),
        (("endpoints", 0), {"url": "udpin://:1"}),
        (("endpoints", 0, "shaper"), "fir"),
        (("endpoints", 0, "system_ids"), [1.0]),
        (("endpoints", 0, "system_ids"), 1),
    ],
)
def test_values_of_other_types_are_not_restored(path: tuple[str | int, ...], value: object) -> None:
    with pytest.raises(ValueError, match=r".+"):
        restore(Parameters, with_value(path, value))


junk = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
)


@given(st.sampled_from([("mode",), ("endpoints",), ("endpoints", 0), ("hold", "vel_ned_mps"), ("link",)]), junk)
def test_any_plain_value_is_restored_or_refused(path: tuple[str | int, ...], value: object) -> None:
    with suppress(ValueError):
        assert isinstance(restore(Parameters, with_value(path, value)), Parameters)
