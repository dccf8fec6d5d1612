"""swingd: estimates and damps the swing of a load slung under a multirotor."""

__version__ = "0.1.0"
