"""Run the unit under a real systemd, as first process of namespaces of its own, and see what it does.

    sudo python -m tools.systemd_trial

Takes a minute and prints what was tried, expected and seen; exit code 1 where they differ. Needs root, systemd, a
cgroup2 file system, and Python, environment and project outside of homes or a system Python of the same version. The
machine's own services, files and units are not touched: systemd sees the units of this project and nothing else.
"""

import json
import os
import shutil
import site
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

from swingd.cli.process import EXIT_CONFIG

PROJECT = Path(__file__).resolve().parents[1]
SYSTEMD = "/lib/systemd/systemd"
UNITS = "/lib/systemd/system"
PORTS = {"swingd": 24540, "other": 24550}
CONFIGURATION = (
    "mode: inline\nlink: {{autopilot: 'udpin://0.0.0.0:{}'}}\nendpoints: [{{url: 'udpin://127.0.0.1:{}'}}]\n"
)
TARGETS = (
    "sysinit",
    "basic",
    "shutdown",
    "final",
    "umount",
    "multi-user",
    "network",
    "paths",
    "slices",
    "sockets",
    "timers",
)
UID = 61500

BOOT = """\
set -eu
mount --make-rprivate /
mount -t tmpfs -o mode=755 tmpfs /mnt
cp -a /etc /mnt/etc && cp -a {work} /mnt/work && mkdir /mnt/units /mnt/empty
for name in {targets}; do test ! -e {units}/$name.target || cp -L {units}/$name.target /mnt/units; done
sed -i '/^Requires=/d; /^Wants=/d' /mnt/units/*.target
cp {project}/systemd/*.service /mnt/units
umount -R /sys/fs/cgroup
for place in /run /var/lib /var/cache /opt; do mount -t tmpfs -o mode=755 tmpfs $place; done
mount --rbind /mnt/etc /etc
mount --bind /mnt/units {units}
mount --bind /mnt/empty /lib/systemd/system-generators
rm -rf /etc/systemd/system/* /etc/init.d /etc/rc*.d
grep -q ^swingd: /etc/passwd || echo swingd:x:{uid}:{uid}::/:/usr/sbin/nologin >> /etc/passwd
grep -q ^swingd: /etc/group || echo swingd:x:{uid}: >> /etc/group
mkdir -p /etc/swingd && cp /mnt/work/*.yaml /etc/swingd
{python} -m venv --without-pip /opt/swingd/venv
printf '%s\\n' {packages} {project} > "$(echo /opt/swingd/venv/lib/python3*/site-packages)/trial.pth"
printf '#!/opt/swingd/venv/bin/python\\nfrom swingd.cli.start import main\\nmain()\\n' > /opt/swingd/venv/bin/swingd
chmod 755 /opt/swingd/venv/bin/swingd
mount -t proc proc /proc
mount --bind /proc/sys /proc/sys && mount -o remount,bind,ro /proc/sys
mount -t cgroup2 cgroup2 /sys/fs/cgroup
container=other exec {systemd} --unit=multi-user.target --log-target=null --show-status=no
"""


class Trial:
    """A systemd of our own, and what was seen of it."""

    def __init__(self, init: int) -> None:
        self._inside = ["nsenter", "-t", str(init), "-m", "-p", "-u", "-i", "-C"]
        self.failed = 0

    def run(self, *command: str) -> "subprocess.CompletedProcess[str]":
        return subprocess.run([*self._inside, *command], capture_output=True, text=True, check=False)

    def systemctl(self, *arguments: str) -> int:
        return self.run("systemctl", *arguments).returncode

    def shown(self, unit: str = "swingd") -> dict[str, str]:
        return dict(
            line.split("=", 1) for line in self.run("systemctl", "show", unit).stdout.splitlines() if "=" in line
        )

    def is_running(self, restarts: int) -> bool:
        shown = self.shown()
        return (shown["ActiveState"], shown["NRestarts"]) == ("active", str(restarts))

    def status(self, name: str = "swingd") -> dict[str, Any]:
        answer: dict[str, Any] = json.loads(
            self.run("/opt/swingd/venv/bin/swingd", "status", name, "--json").stdout or "{}"
        )
        return answer

    def configure(self, text: str) -> None:
        subprocess.run([*self._inside, "tee", "/etc/swingd/swingd.yaml"], input=text.encode(), stdout=-3, check=True)

    def signal(self, name: str) -> None:
        self.systemctl("kill", "-s", name, "--kill-whom=main", "swingd")

    def expect(self, what: str, expected: Callable[[], object], at_most_s: float) -> None:
        """Wait until it is so; say how long that took."""
        begun_s = time.monotonic()
        while not (seen := expected()) and time.monotonic() - begun_s < at_most_s:
            time.sleep(0.05)
        self.failed += not seen
        print(f"{'good' if seen else 'WRONG':6} {what} ({time.monotonic() - begun_s:.2f} s)", flush=True)


def main() -> int:
    """Run the trial."""
    if reason := _why_not():
        print(f"not possible here: {reason}", file=sys.stderr)
        return 1
    with _booted() as trial:
        _try(trial)
    return 1 if trial.failed else 0


def _try(trial: Trial) -> None:
    good = CONFIGURATION.format(PORTS["swingd"], PORTS["swingd"] + 1)
    unit = "swingd.service"
    trial.expect("start: systemctl returns when the links are open", lambda: trial.systemctl("start", unit) == 0, 0.0)
    pid = trial.shown()["MainPID"]
    fields = dict(line.split(":\t", 1) for line in trial.run("cat", f"/proc/{pid}/status").stdout.splitlines())
    trial.expect(
        "no capability, no new privileges, system calls filtered, not root",
        lambda: (
            all(int(fields[name], 16) == 0 for name in ("CapInh", "CapPrm", "CapEff", "CapBnd", "CapAmb"))
            and (fields["NoNewPrivs"], fields["Seccomp"]) == ("1", "2")
            and "0" not in fields["Uid"].split()
        ),
        0.0,
    )
    trial.expect(
        "first start: the filter is compiled into the cache folder", lambda: trial.status()["filter"]["joined"], 90.0
    )
    with _simulated("127.0.0.1", PORTS["swingd"]):
        trial.expect("the filter runs at its rate", lambda: trial.status()["filter"]["rate_hz"] > 90.0, 15.0)
        code = trial.systemctl("reload", unit)  # may return before it has been read
        trial.expect("reload: taken over", lambda: code == 0 and trial.is_running(0), 5.0)
        trial.configure("payload: {mass_kg: heavy}\n")
        trial.systemctl("reload", unit)
        time.sleep(2.0)
        trial.expect(
            "reload, wrong configuration: it flies on",
            lambda: trial.is_running(0) and trial.status()["filter"]["rate_hz"] > 90.0,
            0.0,
        )
        trial.configure(good)
        trial.signal("KILL")
        trial.expect("SIGKILL: started again", lambda: trial.is_running(1), 5.0)
        trial.expect("and estimates", lambda: trial.status().get("filter", {}).get("rate_hz", 0.0) > 90.0, 10.0)
        trial.signal("STOP")
        trial.expect("a process that hangs: ended by the watchdog, started again", lambda: trial.is_running(2), 9.0)
    trial.expect("a second vehicle", lambda: trial.systemctl("start", "swingd@other") == 0, 0.0)
    for address, heard in ((_own_address(), False), ("127.0.0.1", True)):
        if address is not None:
            with _simulated(address, PORTS["other"]):
                time.sleep(4.0)
                trial.expect(
                    f"an autopilot at {address} is {'heard' if heard else 'not heard'}",
                    lambda heard=heard: (trial.status("other")["autopilot"] is not None) is heard,
                    0.0,
                )  # type: ignore[misc]
    trial.expect("stop", lambda: trial.systemctl("stop", unit) == 0 and trial.shown()["ExecMainStatus"] == "0", 0.0)
    trial.expect("the other is still to be asked", lambda: trial.status("other")["pid"], 0.0)
    trial.configure("payload: {mass_kg: heavy}\n")
    trial.systemctl("start", unit)
    time.sleep(1.0)
    shown = trial.shown()
    trial.expect(
        f"wrong configuration at the start: exit code {EXIT_CONFIG}, not started again",
        lambda: (
            (shown["ActiveState"], shown["ExecMainStatus"], shown["NRestarts"]) == ("failed", str(EXIT_CONFIG), "0")
        ),
        0.0,
    )
    judged = trial.run("systemd-analyze", "--no-pager", "security", "--threshold=15", unit)
    print("      ", judged.stdout.splitlines()[-1].lstrip("→ "))
    trial.failed += judged.returncode != 0


# ------------------------------------------------------------------------------------------------- the machine


def _why_not() -> str:
    if os.geteuid() != 0:
        return "only root can make the namespaces"
    for tool in ("unshare", "nsenter", SYSTEMD):
        if shutil.which(tool) is None:
            return f"{tool} is not on this machine"
    if _cgroup2() is None:
        return "no cgroup2 file system that can be written"
    if _python() is None:
        return "no Python of this version outside of homes, which the service does not see"
    if any(str(path).startswith(("/home/", "/root/")) for path in (PROJECT, *site.getsitepackages())):
        return "project or environment lie in a home, which the service does not see"
    return ""


def _python() -> str | None:
    version = f"python{sys.version_info.major}.{sys.version_info.minor}"
    for candidate in (os.path.realpath(sys.executable), f"/usr/bin/{version}", f"/usr/local/bin/{version}"):
        if os.access(candidate, os.X_OK) and not candidate.startswith(("/home/", "/root/")):
            return candidate
    return None


def _cgroup2() -> Path | None:
    for line in Path("/proc/self/mounts").read_text("utf-8").splitlines():
        _, place, kind, options, *_ = line.split()
        if kind == "cgroup2" and "rw" in options.split(","):
            return Path(place)
    return None


def _own_address() -> str | None:
    """Of this machine, but not its loopback; None if it has none."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect(("192.0.2.1", 9))  # sends nothing
        except OSError:
            return None
        address = str(probe.getsockname()[0])
    return None if address.startswith("127.") else address


@contextmanager
def _simulated(address: str, port: int) -> Iterator[None]:
    """A simulated autopilot that speaks to an address."""
    command = [sys.executable, "-m", "swingd", "sim", "--mavlink", f"udpout://{address}:{port}"]
    process = subprocess.Popen(
        [*command, "--set", "simulation.mavlink_bind_port=0"], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    try:
        yield
    finally:
        process.terminate()
        process.wait()


@contextmanager
def _booted() -> Iterator[Trial]:
    """Boot systemd in namespaces and a control group of its own; at the end all of it is gone."""
    root = _cgroup2()
    assert root is not None
    group = root / f"swingd-trial-{os.getpid()}"
    with ExitStack() as stack:
        work = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="swingd-trial-")))
        for name, port in PORTS.items():
            (work / f"{name}.yaml").write_text(CONFIGURATION.format(port, port + 1), encoding="utf-8")
        script = BOOT.format(
            work=work,
            project=PROJECT,
            targets=" ".join(TARGETS),
            units=UNITS,
            uid=UID,
            python=_python(),
            packages=" ".join(site.getsitepackages()),
            systemd=SYSTEMD,
        )
        group.mkdir()
        stack.callback(_remove, group)
        unshare = ["unshare", "--cgroup", "--mount", "--uts", "--ipc", "--pid", "--fork", "sh", "-c", script]
        said = stack.enter_context((work / "said").open("wb"))
        process = subprocess.Popen(
            unshare,
            preexec_fn=lambda: (group / "cgroup.procs").write_text("0"),
            stdin=subprocess.DEVNULL,
            stderr=said,
        )
        stack.callback(process.wait)
        stack.callback(lambda: [os.kill(pid, 9) for pid in _children(process.pid)])
        trial = None
        end_s = time.monotonic() + 30.0
        while trial is None or trial.run("systemctl", "is-active", "multi-user.target").stdout != "active\n":
            if time.monotonic() > end_s or process.poll() is not None:
                raise SystemExit(f"systemd does not come up here: {(work / 'said').read_text('utf-8', 'replace')}")
            time.sleep(0.2)
            trial = next((Trial(pid) for pid in _children(process.pid)), None)
        yield trial


def _children(pid: int) -> list[int]:
    return [int(word) for word in Path(f"/proc/{pid}/task/{pid}/children").read_text("ascii").split()]


def _remove(group: Path) -> None:
    for _ in range(50):
        for folder, _, _ in os.walk(group, topdown=False):
            try:
                os.rmdir(folder)
            except OSError:
                continue
        if not group.exists():
            return
        time.sleep(0.1)


if __name__ == "__main__":
    sys.exit(main())
