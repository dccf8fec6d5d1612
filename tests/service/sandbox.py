"""What systemd does for a unit before its ExecStart, as far as root can do the same without systemd.

Applied: user and groups, umask, no new privileges, empty capability sets, the system call filter with its address
families and namespaces, a read-only system, private ``/tmp``, no homes, ``/proc`` of one's own processes, no devices
but pseudo-devices, runtime, state and cache folders, and a clean environment. Not applied: ``IPAddressDeny`` and
``DeviceAllow``, which systemd's control groups enforce, ``PrivateUsers``, ``KeyringMode``, ``RestrictSUIDSGID``,
``LockPersonality``.
"""

import ctypes.util
import json
import os
import pwd
import shlex
import shutil
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

HOLD = "/mnt"
"""A folder that every system has and nothing here needs: what is to be seen again is held there."""
HIDDEN = {"/home": "755", "/root": "755", "/tmp": "1777", "/var/tmp": "1777", "/run": "755"}
DEVICES = ("null", "zero", "full", "random", "urandom", "tty")
FREE_UID = 61500
"""Below systemd's dynamic ones; taken where there is no such user."""

_FILTER = """\
import ctypes, errno, json, os, socket, sys
class Compare(ctypes.Structure):
    _fields_ = [("arg", ctypes.c_uint), ("op", ctypes.c_int), ("a", ctypes.c_uint64), ("b", ctypes.c_uint64)]
EQUAL, MASKED_EQUAL, ALLOW, ERRNO = 4, 7, 0x7FFF0000, 0x00050000
NAMESPACES = 0x7E020080
given = json.loads(sys.argv[1])
library = ctypes.CDLL("libseccomp.so.2", use_errno=True)
library.seccomp_init.restype = ctypes.c_void_p
library.seccomp_rule_add_array.argtypes = [
    ctypes.c_void_p, ctypes.c_uint32, ctypes.c_int, ctypes.c_uint, ctypes.POINTER(Compare)
]
library.seccomp_load.argtypes = [ctypes.c_void_p]
context = library.seccomp_init(ERRNO | errno.EPERM)
def rule(action, name, *compares):
    number = library.seccomp_syscall_resolve_name(name.encode())
    if number >= 0:
        array = (Compare * len(compares))(*compares)
        assert library.seccomp_rule_add_array(context, action, number, len(compares), array) == 0, name
for name in given["calls"]:
    if name == "socket":
        for family in given["families"]:
            rule(ALLOW, name, Compare(0, EQUAL, getattr(socket, family), 0))
    elif name == "clone":
        rule(ALLOW, name, Compare(0, MASKED_EQUAL, NAMESPACES, 0))
    elif name == "clone3":
        rule(ERRNO | errno.ENOSYS, name)
    elif name not in ("unshare", "setns"):
        rule(ALLOW, name)
assert library.seccomp_load(context) == 0
os.execvp(sys.argv[2], sys.argv[2:])
"""


def why_not() -> str:
    """Say what of this machine does not allow it; empty where it does."""
    if os.geteuid() != 0:
        return "only root can become the unit's user and mount"
    for tool in ("unshare", "setpriv", "systemd-analyze"):
        if shutil.which(tool) is None:
            return f"{tool} is not on this machine"
    if ctypes.util.find_library("seccomp") is None:
        return "libseccomp is not on this machine"
    tried = subprocess.run(
        ["unshare", "--mount", "--propagation", "private", "mount", "-t", "tmpfs", "tmpfs", HOLD],
        capture_output=True,
        text=True,
        check=False,
    )
    return f"mounting is not allowed: {tried.stderr.strip()}" if tried.returncode else ""


@dataclass
class Unit:
    """The settings of a unit's [Service], each with all its values."""

    settings: dict[str, list[str]] = field(default_factory=dict)

    @classmethod
    def of(cls, text: str) -> "Unit":
        unit = cls()
        _, _, service = text.partition("[Service]\n")
        for line in service.partition("\n[")[0].splitlines():
            name, equals, value = line.partition("=")
            if equals and not line.startswith("#"):
                unit.settings.setdefault(name, []).append(value)
        return unit

    def one(self, name: str) -> str:
        (value,) = self.settings[name]
        return value

    def words(self, name: str) -> list[str]:
        return [word for value in self.settings.get(name, []) for word in value.split()]


def system_calls(unit: Unit) -> list[str]:
    """Names that the unit's filter lets pass, groups resolved by systemd itself."""
    allowed = _members("@default")
    for value in unit.settings["SystemCallFilter"]:
        names = {name for word in value.removeprefix("~").split() for name in _members(word)}
        allowed = allowed - names if value.startswith("~") else allowed | names
    return sorted(allowed)


def _members(name: str) -> set[str]:
    if not name.startswith("@"):
        return {name}
    told = subprocess.run(
        ["systemd-analyze", "--no-pager", "syscall-filter", name], capture_output=True, text=True, check=True
    )
    words = [line.strip() for line in told.stdout.splitlines()[1:]]
    return {member for word in words if word and not word.startswith("#") for member in _members(word)}


def sandboxed(
    unit: Unit,
    command: Sequence[str],
    keep: Sequence[Path],
    files: dict[str, Path],
    kernels: Path,
    extra: dict[str, str],
) -> list[str]:
    """Return the command line that runs a command as the unit would.

    Parameters
    ----------
    unit : Unit
        What to apply.
    command : sequence of str
        What to run; its process is that of the returned command.
    keep : sequence of Path
        Folders that must be seen although they may lie in a home or in ``/tmp``: interpreter, environment, project.
    files : dict
        What to put below ``/etc``, by its name there.
    kernels : Path
        Compiled filter, for the cache folder.
    extra : dict
        Variables that systemd sets itself, such as ``NOTIFY_SOCKET``.
    """
    name = unit.one("User")
    uid = _uid(name)
    groups = [line.split(":") for line in Path("/etc/group").read_text("utf-8").splitlines()]
    supplementary = [entry[2] for entry in groups if entry[0] in unit.words("SupplementaryGroups")]
    folders = {"Runtime": "/run", "State": "/var/lib", "Cache": "/var/cache"}
    environment = {
        "PATH": "/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin",
        "LANG": "C.UTF-8",
        "USER": name,
        "LOGNAME": name,
        "HOME": "/var/lib/swingd",
        **{f"{kind.upper()}_DIRECTORY": f"{base}/{unit.one(f'{kind}Directory')}" for kind, base in folders.items()},
        **dict(word.replace("%C", "/var/cache").split("=", 1) for word in unit.words("Environment")),
        **extra,
    }
    kept = [str(path) for path in keep]
    kept = [path for path in kept if not any(path != other and path.startswith(f"{other}/") for other in kept)]
    lines = ["set -eu", f"mount -t tmpfs -o mode=755 tmpfs {HOLD}"]
    for number, path in enumerate(kept):
        lines += [f"mkdir {HOLD}/{number}", f"mount --rbind {shlex.quote(path)} {HOLD}/{number}"]
    lines += [
        f"cp -a /etc {HOLD}/etc",
        f"grep -q ^{name}: {HOLD}/etc/passwd || echo {name}:x:{uid}:{uid}::/:/usr/sbin/nologin >> {HOLD}/etc/passwd",
        f"grep -q ^{name}: {HOLD}/etc/group || echo {name}:x:{uid}: >> {HOLD}/etc/group",
        *(f"install -D -m 644 {shlex.quote(str(path))} {HOLD}/etc/{place}" for place, path in files.items()),
        f"cp -a {shlex.quote(str(kernels))} {HOLD}/kernels",
        f"mkdir {HOLD}/dev",
        *(f"touch {HOLD}/dev/{device} && mount --bind /dev/{device} {HOLD}/dev/{device}" for device in DEVICES),
        *(f"mount -t tmpfs -o mode={mode} tmpfs {path}" for path, mode in HIDDEN.items()),
        *(f"mount -t tmpfs -o mode=755 tmpfs {base}" for base in ("/var/lib", "/var/cache")),
    ]
    for kind, base in folders.items():
        mode = unit.one(f"{kind}DirectoryMode")
        lines.append(f"install -d -m {mode} -o {uid} -g {uid} {base}/{unit.one(f'{kind}Directory')}")
    cached = f"/var/cache/{unit.one('CacheDirectory')}/{kernels.name}"
    lines += [f"cp -a {HOLD}/kernels {cached}", f"chown -R {uid}:{uid} {cached}"]
    for number, path in enumerate(kept):
        lines += [f"mkdir -p {shlex.quote(path)}", f"mount --rbind {HOLD}/{number} {shlex.quote(path)}"]
    writable = [*folders.values(), "/tmp", "/var/tmp", "/proc", "/dev"]
    lines += [
        f"mount --rbind {HOLD}/etc /etc",
        f"mount --rbind {HOLD}/dev /dev",
        f"umount -l {HOLD}",
        "mount -t proc -o nosuid,nodev,noexec,hidepid=invisible proc /proc",
        "mount --rbind /proc/sys /proc/sys",
        # ProtectSystem=strict: what is not among the unit's own folders can only be read.
        "cut -d' ' -f2 /proc/self/mounts | sort -u | while read -r place; do case \"$place\" in "
        f'{"|".join(writable)}|/dev/*) ;; *) mount -o remount,bind,ro "$place" 2>/dev/null || true;; esac; done',
        f"umask {unit.one('UMask')}",
        # Needs a capability that containers may lack.
        f"(echo {unit.one('OOMScoreAdjust')} > /proc/self/oom_score_adj) 2>/dev/null || true",
        "cd /",
    ]
    given = json.dumps({"calls": system_calls(unit), "families": unit.words("RestrictAddressFamilies")})
    assert unit.one("NoNewPrivileges") == "yes"
    assert unit.one("CapabilityBoundingSet") == ""
    privileges = [
        *("setpriv", "--reuid", str(uid), "--regid", str(uid)),
        *(("--groups", ",".join(supplementary)) if supplementary else ("--clear-groups",)),
        *("--no-new-privs", "--bounding-set=-all", "--inh-caps=-all", "--ambient-caps=-all"),
    ]
    launch = [
        *("env", "-i", *(f"{key}={value}" for key, value in environment.items())),
        *privileges,
        *(sys.executable, "-I", "-c", _FILTER, given, *command),
    ]
    lines.append(f"exec {shlex.join(launch)}")
    return ["unshare", "--mount", "--propagation", "private", "/bin/sh", "-c", "\n".join(lines)]


def _uid(name: str) -> int:
    try:
        return pwd.getpwnam(name).pw_uid
    except KeyError:
        return FREE_UID
