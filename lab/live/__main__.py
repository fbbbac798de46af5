"""The page beside a run: `python -m lab.live NUMBER open|quiet`.

The program that runs the experiment has opened the socket and passes its number; `open`: in the person's browser. The token
comes as the first line of standard input, where no list of processes shows it. Each further line names the recording to
show next. When that input ends, the run has ended. Requests of viewers to the run go to standard output, a JSON line each, and
are dropped if the run does not read them.
"""

from __future__ import annotations

import json
import os
import socket
import sys
import threading
from pathlib import Path

from .beside import opened_in_browser
from .show import PageAddress, Show, ShownRecording


def main(number: str, browser: str) -> None:
    """Serve until standard input ends."""
    where = PageAddress(socket.socket(fileno=int(number)), sys.stdin.readline().strip())
    os.set_blocking(sys.stdout.fileno(), False)

    def ask(kind: str, text: str) -> bool:
        """Pass a request on to the run: a line that is written whole or not at all."""
        message = json.dumps({"shown": show.count, "kind": kind, "text": text}, ensure_ascii=False)
        line = message.encode("utf-8", "backslashreplace") + b"\n"
        try:
            return os.write(sys.stdout.fileno(), line) == len(line)
        except OSError:
            return False

    def listen() -> None:
        for line in sys.stdin:
            order = json.loads(line)
            show.follow(ShownRecording(Path(order["file"]), order["part"], order["more"]))
        show.over()

    show = Show(where, steer=ask)
    threading.Thread(target=listen, name="live-until", daemon=True).start()
    if browser == "open":
        opened_in_browser(where.address)
    show.run(stay=False)


if __name__ == "__main__":
    main(*sys.argv[1:])
