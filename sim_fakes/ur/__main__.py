"""`python -m sim_fakes.ur`: one controller; prints `ready` when it accepts clients."""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import os
import sys

import timing

from ..instrument import loopback
from ..punctual import punctual
from .controller import FakeController
from .server import Address, UrServer
from .variables import Version


def version(text: str) -> Version:
    """Four numbers joined by dots; CB3 (3.x), e-Series (5.x) or PolyScope X (10.x)."""
    major, minor, bugfix, build = (int(part) for part in text.split("."))
    if major not in (3, 5, 10):
        raise ValueError("major version 3 (CB3), 5 (e-Series) or 10 (PolyScope X)")
    return major, minor, bugfix, build


def address(text: str) -> Address:
    """host:port"""
    host, port = text.rsplit(":", 1)
    return host, int(port)


def factor(text: str) -> float:
    """A number above 0."""
    value = float(text)
    if not value > 0:
        raise ValueError("must be above 0")
    return value


def _end_with_parent() -> None:
    """Leave when the other end of standard input closes: also when the parent was killed."""
    sys.stdin.buffer.read()
    os._exit(0)


def main() -> None:
    """Parse the arguments and run."""
    parser = argparse.ArgumentParser(prog="python -m sim_fakes.ur", description=__doc__)
    parser.add_argument("--host", type=loopback, required=True, help="loopback address of its own, 127.x.y.z")
    parser.add_argument("--version", type=version, default=version("3.15.8.106339"), help="PolyScope version")
    parser.add_argument("--speed", type=factor, default=1.0, help="how many times faster than the host the rig runs")
    parser.add_argument("--backdoor", metavar="PATH", help="Unix socket of the back door; none when not given")
    parser.add_argument("--pose-to", type=address, metavar="HOST:PORT", help="send the TCP pose there by UDP each cycle")
    parser.add_argument("--clock-start", type=float, help="host monotonic time (s) of rig time 0; now when not given")
    parser.add_argument("--no-dashboard", action="store_true", help="the dashboard server is switched off")
    parser.add_argument("--seed", type=int, default=0, help="of the measurement noise")
    parser.add_argument("--die-with-parent", action="store_true", help="end when standard input closes")
    arguments = parser.parse_args()
    if arguments.die_with_parent:
        timing.Thread(target=_end_with_parent, daemon=True).start()
    punctual()
    controller = FakeController(arguments.version, arguments.speed, arguments.seed)
    start = timing.now() if arguments.clock_start is None else arguments.clock_start
    server = UrServer(controller, arguments.host, start, dashboard=not arguments.no_dashboard)
    with contextlib.suppress(KeyboardInterrupt):
        asyncio.run(server.run(arguments.backdoor, arguments.pose_to, lambda: print("ready", flush=True)))


if __name__ == "__main__":
    main()
