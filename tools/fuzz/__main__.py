"""Feeds what swingd reads from others with bytes that reach ever more of its code, by atheris (libFuzzer).

    make fuzz                              # every target for a minute
    make fuzz SECONDS=3600 TARGET=ulog
    python -m tools.fuzz ulog out/fuzz/ulog/crash-...    # one input again, without the fuzzer

What was found lies in out/fuzz/TARGET: ``corpus`` is where the next run begins, ``crash-``, ``timeout-`` and ``oom-``
are inputs that must become tests. Exit code 1: a finding; 2: wrong usage.
"""

import argparse
import importlib
import os
import pkgutil
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import NoReturn

ROOT = Path(__file__).parents[2]
NAMES = (
    *("codec", "adapter", "router", "parameter_server", "csv_log", "truth", "tlog", "ulog", "event_log"),
    *("configuration", "console"),
)
LENGTH_MAX = 4096
SLOW_S = 20
"""One input that takes longer is a finding."""
MEMORY_MB = 2048


def main(arguments: Sequence[str] | None = None) -> int:
    """Fuzz, or run inputs again; return the exit code."""
    parser = argparse.ArgumentParser(prog="tools.fuzz", description=__doc__, formatter_class=_Plain)
    parser.add_argument("target", choices=(*NAMES, "all"))
    parser.add_argument("inputs", nargs="*", type=Path, metavar="FILE", help="inputs to run again instead of fuzzing")
    parser.add_argument("--seconds", type=int, default=60, metavar="S", help="for each target; default: 60")
    parser.add_argument("-o", "--out", type=Path, default=ROOT / "out/fuzz", metavar="FOLDER")
    given = parser.parse_args(arguments)
    if given.target != "all":
        if given.inputs:
            return _again(given.target, given.inputs)
        _fuzz(given.target, given.seconds, given.out.absolute())
    if given.inputs:
        parser.error("inputs belong to one target; expected its name instead of all")
    # The fuzzer ends the process that it runs in.
    command = [sys.executable, "-m", "tools.fuzz", "--seconds", str(given.seconds), "-o", str(given.out)]
    failed = [name for name in NAMES if subprocess.run([*command, name], check=False).returncode]
    print(f"tools.fuzz: {len(NAMES) - len(failed)} targets without a finding; with one: {', '.join(failed) or 'none'}")
    return 1 if failed else 0


class _Plain(argparse.RawDescriptionHelpFormatter):
    """Keeps the lines of the description."""


def _again(name: str, paths: Sequence[Path]) -> int:
    check = importlib.import_module("tools.fuzz.targets").TARGETS[name].check
    for path in paths:
        check(path.read_bytes())
        print(f"{path}: nothing to find")
    return 0


def _fuzz(name: str, seconds: int, out: Path) -> NoReturn:
    import atheris

    # numba does not understand the fuzzer's instructions between those of a kernel.
    for module in pkgutil.iter_modules([str(ROOT / "swingd/core")], "swingd.core."):
        importlib.import_module(module.name)
    with atheris.instrument_imports(include=["swingd"]):
        target = importlib.import_module("tools.fuzz.targets").TARGETS[name]
    corpus = out / name / "corpus"
    corpus.mkdir(parents=True, exist_ok=True)
    for number, seed in enumerate(target.seeds()):
        (corpus / f"seed-{number}").write_bytes(seed)
    options = (
        f"-max_total_time={seconds}",
        f"-max_len={LENGTH_MAX}",
        f"-timeout={SLOW_S}",
        f"-rss_limit_mb={MEMORY_MB}",
        f"-artifact_prefix={out / name}{os.sep}",
        "-print_final_stats=1",
        "-verbosity=1",
    )
    atheris.Setup([name, *options, str(corpus)], target.check)
    atheris.Fuzz()
    raise AssertionError("the fuzzer ends its process")


if __name__ == "__main__":
    sys.exit(main())
