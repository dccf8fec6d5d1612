"""How the studies' figures look, and how a set of them is written."""

from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from swingd.model.errors import StudyError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SUFFIXES = ("png", "svg")

# At 7 in. a picture is 700 px wide with the sizes below as they are seen, and sharp on a dense screen by its dpi.
WIDTH_IN = 7.0
DPI = 160
STYLE: Any = {
    "figure.dpi": DPI,
    "savefig.dpi": DPI,
    "figure.titlesize": 10.5,
    "figure.titleweight": "bold",
    "font.size": 9.5,
    "axes.titlesize": 9.5,
    "axes.titlelocation": "left",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.xmargin": 0.01,
    "grid.alpha": 0.25,
    "grid.linewidth": 0.6,
    "legend.fontsize": 9.0,
    "legend.frameon": False,
    "legend.handlelength": 1.8,
    "legend.columnspacing": 1.2,
    "lines.linewidth": 1.2,
    # The same flights give the same bytes.
    "svg.hashsalt": "swingd",
}


def numbered(compositions: "Iterable[tuple[int, str, Callable[[], Figure]]]") -> "Iterator[tuple[int, Figure]]":
    """Compose figures in the studies' style, one after the other.

    Parameters
    ----------
    compositions : triples
        Number in the paper, title, and what composes the figure.

    Yields
    ------
    pairs of number and Figure
        With number and title above it.
    """
    import matplotlib as mpl

    for number, title, compose in compositions:
        with mpl.rc_context(STYLE):
            figure = compose()
            figure.suptitle(f"Figure {number}. {title}", x=0.01, ha="left")
        yield number, figure


def save(
    drawn: "Iterable[tuple[int, Figure]]",
    folder: Path,
    suffix: str = "png",
    watch: Callable[[float], None] = lambda _share: None,
) -> list[Path]:
    """Write figures under their numbers in the paper.

    Parameters
    ----------
    drawn : pairs of number and Figure
        All are composed before the first is written: a missing flight leaves no half a set.
    folder : Path
        Made if need be.
    suffix : str
        ``png`` or ``svg``.
    watch : callable
        Told the share done, 0..1.

    Returns
    -------
    list of Path
        What was written, in the order given.

    Raises
    ------
    StudyError
        If the suffix is none of both.
    """
    import matplotlib as mpl

    if suffix not in SUFFIXES:
        raise StudyError(f"picture suffix {suffix!r}: expected one of {', '.join(SUFFIXES)}")
    composed = list(drawn)
    folder.mkdir(parents=True, exist_ok=True)
    paths = []
    with mpl.rc_context(STYLE):
        for number, figure in composed:
            path = folder / f"figure{number:02d}.{suffix}"
            figure.savefig(path, metadata={"Date": None} if suffix == "svg" else None)
            paths.append(path)
            watch(len(paths) / len(composed))
    return paths
