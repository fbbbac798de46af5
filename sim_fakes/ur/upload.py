"""Script upload, ports 30001 to 30003: text goes in; the state these ports stream is left out, as nobody reads it."""

from __future__ import annotations

import re

from .wire import Connection

PORTS = (30001, 30002, 30003)
_PROGRAM = re.compile(rb"(?m)^def \w+\(\):\n(?:.*\n)*?end\n")


class UploadConnection(Connection):
    """One client that sends programs; a program ends with `end` in the first column."""

    def take(self) -> bool:
        program = _PROGRAM.search(self.buffer)
        if program is None:
            if len(self.buffer) > 1 << 20:
                self.hub.violation(f"script: {len(self.buffer)} bytes without a program")
                self.transport.abort()
            return False
        if self.buffer[: program.start()].strip():
            self.hub.violation("script: text outside a program")
        self.buffer = self.buffer[program.end() :]
        self.hub.controller.load(program[0].decode("utf-8", "replace"))
        return True
