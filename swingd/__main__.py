"""``python -m swingd``."""

from swingd.cli.start import main

main()
