"""What the fuzzer feeds, fed by hypothesis: the seeds, what becomes of them, and any bytes."""

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tools.fuzz.__main__ import NAMES, main
from tools.fuzz.targets import TARGETS

EXAMPLES = settings(
    max_examples=120, deadline=None, derandomize=True, suppress_health_check=[HealthCheck.function_scoped_fixture]
)


def test_every_target_can_be_named() -> None:
    assert set(NAMES) == set(TARGETS)


@pytest.mark.parametrize("name", TARGETS)
def test_the_seeds_are_good(name: str) -> None:
    for seed in TARGETS[name].seeds():
        TARGETS[name].check(seed)


@pytest.mark.parametrize("name", TARGETS)
@EXAMPLES
@given(data=st.data())
def test_any_bytes_give_an_event_or_a_refusal(name: str, data: st.DataObject) -> None:
    """Noise, and good inputs with a piece left out, put in, repeated or changed."""
    target = TARGETS[name]
    noise = data.draw(st.binary(max_size=120))
    seed = data.draw(st.sampled_from([b"", *target.seeds()]))
    begin = data.draw(st.integers(0, len(seed)))
    end = data.draw(st.integers(begin, len(seed)))
    repeated = data.draw(st.integers(0, 2))
    target.check(seed[:begin] + noise + seed[begin:end] * repeated + seed[end:])


def test_an_input_is_run_again_by_its_name(tmp_path, capsys) -> None:
    path = tmp_path / "crash-1"
    path.write_bytes(b"\xfd\x00")
    assert main(["codec", str(path)]) == 0
    assert "nothing to find" in capsys.readouterr().out
