"""Random values within the declared bounds."""

from enum import Enum
from typing import Any

from hypothesis import strategies as st

from swingd.config.schema import ROOT, TEXT_MAX, Group, Key
from swingd.model.parameters import Parameters

TEXTS = st.text(st.characters(codec="utf-8", categories=("L", "N", "P", "S", "Zs")), min_size=1, max_size=TEXT_MAX)
URLS = st.builds(
    "{}:{}".format, st.sampled_from(["udpin://127.0.0.1", "tcpin://", "udpout://[::1]"]), st.integers(1, 9)
)


def values(key: Key) -> st.SearchStrategy[Any]:
    """Anything that a key may hold, as its dataclass holds it."""
    if key.sizes is None:
        return components(key)
    least, most = key.sizes
    # Longer lists cost time and show nothing more.
    return st.lists(components(key), min_size=least, max_size=min(most, 4)).map(tuple)


def components(key: Key) -> st.SearchStrategy[Any]:
    if key.item is not None:
        return groups(key.item)
    if key.low is not None and key.high is not None:
        if key.component is int:
            return st.integers(int(key.low), int(key.high))
        return st.floats(key.low, key.high)
    if key.type is bool:
        return st.booleans()
    if key.name == "gp_ekf.model":
        return st.just("none")  # any other name is that of a file, which is read
    if key.choices:
        return st.sampled_from(list(key.type) if issubclass(key.type, Enum) else key.choices)
    return TEXTS | URLS


def groups(group: Group) -> st.SearchStrategy[Any]:
    members = group.members.items()
    return st.builds(group.type, **{name: groups(m) if isinstance(m, Group) else values(m) for name, m in members})


def parameter_sets() -> st.SearchStrategy[Parameters]:
    return groups(ROOT)
