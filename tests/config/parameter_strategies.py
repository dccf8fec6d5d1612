"""Random values within the declared bounds."""

from enum import Enum
from typing import Any

from hypothesis import strategies as st

from swingd.config.schema import GROUPS, KEYS, TEXT_MAX, Key, build, model_of, plain
from swingd.model.parameters import Parameters


def values(key: Key) -> st.SearchStrategy[Any]:
    """Anything that a key may hold, as its dataclass holds it."""
    if key.low is not None and key.high is not None:
        if key.type is int:
            return st.integers(int(key.low), int(key.high))
        number = st.floats(key.low, key.high)
        return number if key.size == 1 else st.tuples(*[number] * key.size)
    if key.type is bool:
        return st.booleans()
    if key.choices:
        return st.sampled_from(list(key.type) if issubclass(key.type, Enum) else key.choices)
    return st.text(st.characters(codec="utf-8", categories=("L", "N", "P", "S", "Zs")), min_size=1, max_size=TEXT_MAX)


def parameter_sets() -> st.SearchStrategy[Parameters]:
    return st.fixed_dictionaries({name: values(key) for name, key in KEYS.items()}).map(
        lambda chosen: build(
            model_of(Parameters).model_validate(
                {
                    **{name: plain(chosen[name]) for name in KEYS if "." not in name},
                    **{
                        group: {key.path[-1]: plain(chosen[key.name]) for key in KEYS.values() if key.path[0] == group}
                        for group in GROUPS
                    },
                }
            )
        )
    )
