from collections import Counter

from hypothesis import given
from hypothesis import strategies as st

from swingd.link.status_text import TEXTS_MAX, WINDOW_S, RefusalLimiter, StatusTextLimiter
from swingd.model.actions import Severity, StatusText

TEXTS = st.builds(StatusText, st.sampled_from(Severity), st.sampled_from("abcdefghijklmnopqrstuvwxyz"))


def info(text: str) -> StatusText:
    return StatusText(Severity.INFO, text)


def warning(text: str) -> StatusText:
    return StatusText(Severity.WARNING, text)


def ticked(limiter: StatusTextLimiter, begin_s: float, end_s: float) -> list[tuple[float, StatusText]]:
    sent = []
    for step in range(round((end_s - begin_s) * 20)):
        t_s = begin_s + step / 20
        sent += [(t_s, text) for text in limiter.tick(t_s)]
    return sent


def test_a_text_leaves_at_once():
    assert StatusTextLimiter().offer(5.0, info("correction on")) == (info("correction on"),)


def test_a_text_that_comes_again_and_again_is_told_twice_with_its_count():
    limiter = StatusTextLimiter()
    sent = [(t, text) for t in range(8) for text in limiter.offer(float(t), info("late"))]
    assert sent == [(0, info("late"))]
    ((t_s, text),) = ticked(limiter, 8.0, 60.0)
    assert text == info("late (7 times)")
    assert WINDOW_S <= t_s < WINDOW_S + 0.1


def test_a_text_that_comes_once_more_is_told_as_it_is():
    limiter = StatusTextLimiter()
    limiter.offer(0.0, info("late"))
    assert limiter.offer(4.0, info("late")) == ()
    assert [text for _, text in ticked(limiter, 4.0, 30.0)] == [info("late")]
    assert limiter.offer(40.0, info("late")) == (info("late"),)


def test_lesser_texts_leave_places_to_warnings():
    limiter = StatusTextLimiter()
    passed = [text for i in range(20) for text in limiter.offer(0.0, info(str(i)))]
    assert len(passed) == TEXTS_MAX - 4
    warned = [text for i in range(4) for text in limiter.offer(0.1, warning(str(i)))]
    assert warned == [warning(str(i)) for i in range(4)]
    assert limiter.offer(0.2, warning("one too many")) == ()


def test_what_waits_leaves_the_worst_first_in_the_order_of_arrival():
    limiter = StatusTextLimiter()
    for i in range(TEXTS_MAX):
        limiter.offer(0.0, warning(f"first {i}"))
    for text in (info("a"), warning("b"), info("c"), StatusText(Severity.CRITICAL, "d"), warning("e")):
        assert limiter.offer(1.0, text) == ()
    assert limiter.tick(WINDOW_S) == (
        StatusText(Severity.CRITICAL, "d"),
        warning("b"),
        warning("e"),
        info("a"),
        info("c"),
    )


def test_what_waits_too_long_is_dropped_and_counted():
    # GIVEN warnings that take every place as soon as it is free
    limiter = StatusTextLimiter()
    sent = []
    for t in range(60):
        sent += [*limiter.tick(float(t)), *limiter.offer(float(t), warning(str(t)))]
        if t == 9:
            sent += limiter.offer(9.0, info("stale"))
    assert len(sent) == 60
    # WHEN they end
    later = [text for _, text in ticked(limiter, 60.0, 120.0)]
    # THEN what waited for 30 s in vain is not told as if it were so
    assert info("stale") not in [*sent, *later]
    assert limiter.dropped == 1


def test_a_flood_of_different_texts_drops_the_least_severe():
    limiter = StatusTextLimiter()
    for i in range(1000):
        limiter.offer(0.0, info(str(i)))
    grave = [text for i in range(10) for text in limiter.offer(0.0, warning(str(i)))]
    assert len(grave) == 4
    later = [text for _, text in ticked(limiter, 0.0, 20.0)]
    assert [text for text in later if text.severity is Severity.WARNING] == [warning(str(i)) for i in range(4, 10)]
    assert limiter.dropped >= 970
    assert len(limiter._lines) <= 32


@given(st.lists(st.tuples(st.floats(0.0, 2.0), st.lists(TEXTS, max_size=20)), max_size=40))
def test_never_more_than_the_limit_in_any_window_and_nothing_is_made_up(rounds):
    limiter = StatusTextLimiter()
    offered: Counter[StatusText] = Counter()
    sent: list[tuple[float, StatusText]] = []
    t_s = 0.0
    for wait_s, texts in rounds:
        t_s += wait_s
        sent += [(t_s, text) for text in limiter.tick(t_s)]
        for text in texts:
            offered[text] += 1
            sent += [(t_s, out) for out in limiter.offer(t_s, text)]
    sent += ticked(limiter, t_s + 0.05, t_s + 120.0)
    times = [t for t, _ in sent]
    for i, begin_s in enumerate(times):
        assert sum(begin_s <= t < begin_s + WINDOW_S for t in times[i:]) <= TEXTS_MAX
    told: Counter[StatusText] = Counter()
    for _, text in sent:
        name, _, count = text.text.partition(" (")
        told[StatusText(text.severity, name)] += int(count.removesuffix(" times)")) if count else 1
    assert all(told[text] <= offered[text] for text in told)
    # Each was told or counted as dropped.
    assert told.total() + limiter.dropped == offered.total()
    assert not limiter._lines


def test_a_refusal_passes_once_a_second_and_the_same_once_in_ten():
    limiter = RefusalLimiter()
    assert [limiter.offer(t, "a") for t in (0.0, 0.5, 2.0, 9.9, 10.0)] == ["a", None, None, None, "a"]
    assert [limiter.offer(t, "b") for t in (10.5, 11.0)] == [None, "b"]


@given(st.lists(st.tuples(st.floats(0.0, 3.0), st.text(max_size=3)), max_size=60))
def test_refusals_keep_nothing_for_ever(offers):
    limiter = RefusalLimiter()
    t_s = 0.0
    for wait_s, text in offers:
        t_s += wait_s
        limiter.offer(t_s, text)
        assert len(limiter._texts) <= 11
