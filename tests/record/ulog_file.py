"""Writes ULog files, after the format's public specification."""

import struct
from pathlib import Path

SIZES = {"uint64_t": "Q", "float": "f", "uint8_t": "B", "bool": "?", "uint32_t": "I", "uint16_t": "H"}


class UlogFile:
    """Collects topics and their samples, then writes them in the order of time."""

    def __init__(self) -> None:
        self._formats: list[bytes] = []
        self._subscriptions: list[bytes] = []
        self._structs: dict[tuple[str, int], tuple[int, struct.Struct, list[str]]] = {}
        self._samples: list[tuple[int, bytes]] = []

    def topic(self, name: str, fields: str, instance: int = 0) -> None:
        """Declare a topic; ``fields`` as in a format message, without the time stamp."""
        key = (name, instance)
        types = [field.split() for field in f"uint64_t timestamp;{fields}".strip(";").split(";")]
        layout, names = "<", []
        for kind, field in types:
            base, _, count = kind.partition("[")
            n = int(count.rstrip("]")) if count else 1
            layout += f"{n}{SIZES[base]}" if n > 1 else SIZES[base]
            names.append(field)
        if (name, 0) not in self._structs:
            text = f"{name}:" + "".join(f"{kind} {field};" for kind, field in types)
            self._formats.append(self._message("F", text.encode()))
        number = len(self._structs)
        self._structs[key] = (number, struct.Struct(layout), names)
        self._subscriptions.append(self._message("A", struct.pack("<BH", instance, number) + name.encode()))

    def add(self, name: str, t_s: float, *values: float, instance: int = 0) -> None:
        """Add a sample; arrays are given element by element."""
        number, layout, _ = self._structs[name, instance]
        stamp_us = round(t_s * 1e6)
        data = struct.pack("<H", number) + layout.pack(stamp_us, *values)
        self._samples.append((stamp_us, self._message("D", data)))

    @staticmethod
    def _message(kind: str, data: bytes) -> bytes:
        return struct.pack("<HB", len(data), ord(kind)) + data

    def bytes(self) -> bytes:
        """The whole file."""
        header = b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 0)
        flags = self._message("B", bytes(40))
        samples = [data for _, data in sorted(self._samples, key=lambda s: s[0])]
        return b"".join([header, flags, *self._formats, *self._subscriptions, *samples])

    def write(self, path: Path) -> Path:
        """Write the file."""
        path.write_bytes(self.bytes())
        return path
