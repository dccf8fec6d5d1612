"""Where the ``swingd`` command begins."""

import sys


def main() -> None:
    """Run the command line and exit."""
    if sys.argv[1:2] == ["run"]:
        # Without the command line's library, which takes longer to load than the daemon.
        from swingd.cli import run

        sys.exit(run.main(sys.argv[2:]))
    from swingd.cli.main import app

    app(prog_name="swingd")
