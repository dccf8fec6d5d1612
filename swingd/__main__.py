"""``python -m swingd``."""

from swingd.cli.main import main

main()
