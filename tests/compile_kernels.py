"""Compile the kernels of swingd/core before the tests, each once and on all cores.

Without it every process of the tests finds an empty cache and compiles all of them for itself. A module is compiled
when those that it imports are in the cache, so that no two processes compile the same.
"""

import ast
import importlib
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from graphlib import TopologicalSorter
from pathlib import Path

ROOM = "swingd.core"
FOLDER = Path(__file__).resolve().parents[1].joinpath(*ROOM.split("."))


def imported(source: str) -> set[str]:
    """Names of the room's modules that a source imports."""
    names = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.ImportFrom) and node.module == ROOM:
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and str(node.module).startswith(f"{ROOM}."):
            names.add(str(node.module).rpartition(".")[2])
    return names


def compile_module(name: str) -> None:
    importlib.import_module(f"{ROOM}.{name}")


def main() -> None:
    modules = TopologicalSorter({path.stem: imported(path.read_text("utf-8")) for path in FOLDER.glob("*.py")})
    modules.prepare()
    running: dict[Future[None], str] = {}
    with ProcessPoolExecutor() as processes:
        while modules.is_active():
            running |= {processes.submit(compile_module, name): name for name in modules.get_ready()}
            for future in wait(running, return_when=FIRST_COMPLETED).done:
                future.result()
                modules.done(running.pop(future))


if __name__ == "__main__":
    main()
