"""The door of a guard: where any program of this computer finds out who owns a rig, and asks for it to be landed.

A guard owns names: one for the path of its rig.yaml, one for each line that only one program may use. Each name is an
abstract Unix socket, which the kernel keeps: it is exclusive, it belongs to no file that anybody could edit or delete, it
ends with its process, and every user of this computer may connect to it. The kernel also says who connects.

A question is one line of JSON, `{"do": "who"}` or `{"do": "land"}`; so is the answer. A guard that is asked to land lands
first and answers afterwards. This module needs neither rig.yaml nor any driver.
"""

from __future__ import annotations

import contextlib
import errno
import hashlib
import json
import os
import pwd
import socket
import struct
from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Protocol, TypeVar

import timing
from recordings.json_text import read_json

from .latch import RigLocked
from .report import SafeReport

A = TypeVar("A")
B = TypeVar("B")
PREFIX = "softlab/rig/"
TAKE_WITHIN = 8.0
"""Host seconds to wait for an earlier guard that is still landing; it disconnects the arm, which takes 2 s."""
WHO_WITHIN = 2.0
"""Host seconds in which a guard that is alive says who it is; its program gives it up after as long a silence."""
LAND_WITHIN = 30.0
"""Host seconds for a landing by another guard: longer than any landing takes."""
LONGEST = 100_000
"""Bytes of a question or an answer that are read."""
MOST_AT_ONCE = 16
"""Connections that are served at the same time; more wait in the kernel's queue."""
SLICE = 0.05
"""Host seconds between two tries to take a name that is about to be free."""


@dataclass(frozen=True)
class Owner:
    """The guard that owns a rig."""

    guard: str
    """Unique to the guard; empty when the owner does not answer."""
    pid: int
    user: str
    rig: str = ""
    names: frozenset[str] = frozenset()
    """All that it owns, see `names_of_path` and `lab.guard.instruments.exclusive`."""
    about: str = ""
    """The command that it serves, with its process and start."""
    ending: bool = False
    """Its program has ended: it lands, then it is gone."""

    def __str__(self) -> str:
        served = self.about or "a program that does not answer"
        return f"{served}; its guard is process {self.pid} of user {self.user}"


class Guarding(Protocol):
    """What a door asks its guard."""

    ending: bool

    def hand_over(self, by: str) -> SafeReport:
        """Land for good."""

    def locked(self) -> str:
        """Why the rig is locked; empty when it is free."""


def names_of_path(rig: Path) -> frozenset[str]:
    """The names that stand for a rig.yaml, whether or not it exists: its path as written and with links followed."""
    return frozenset(f"path:{p}" for p in (os.path.abspath(rig), os.path.realpath(rig)))


class Door:
    """The names of one guard, and the thread that answers at them."""

    def __init__(self, names: Collection[str], guard: Guarding, rig: str = "", about: str = "") -> None:
        """`rig`: path of rig.yaml; `about`: the command that the guard serves. Both are answers to who owns the rig."""
        self._names, self._guard = frozenset(names), guard
        self._about = {"guard": f"{os.getpid()}-{id(self):x}", "rig": rig, "about": about, "names": sorted(names)}
        self._sockets: list[socket.socket] = []
        self._turns = timing.Queue()
        """One for each question that may still be answered at the same time; its number means nothing."""
        for turn in range(MOST_AT_ONCE):
            self._turns.put(turn)

    def open(self, within: float = TAKE_WITHIN) -> None:
        """Own all names. Raises RigLocked at once when a guard owns one whose program is alive, and after `within` host
        seconds when one that is ending has not ended."""
        deadline = timing.now() + within
        try:
            for name in sorted(self._names):
                while (taken := _bound(name)) is None:
                    late = timing.now() > deadline
                    demand_free([name], ending_too=late)
                    if late:
                        raise RigLocked(f"{name} is owned by a program that cannot be asked; end it first")
                    timing.sleep(SLICE)
                self._sockets.append(taken)
        except BaseException:
            self.close()
            raise
        timing.Thread(target=self._serve, name="door", daemon=True).start()

    def close(self) -> None:
        """Give the names back."""
        sockets, self._sockets = self._sockets, []
        for taken in sockets:
            taken.close()

    # -- answering
    def _serve(self) -> None:
        """Accept connections at all names until the door is closed; each is answered by a thread of its own, so that a slow one
        delays nobody. While MOST_AT_ONCE are being answered, others wait."""
        while self._sockets:
            try:
                asked_at = timing.readable(self._sockets.copy(), SLICE)
            except (OSError, ValueError):  # closed meanwhile
                continue
            for asked in asked_at:
                with contextlib.suppress(OSError):
                    connection, _ = asked.accept()
                    turn = self._turns.get()
                    timing.Thread(target=self._answer, args=(connection, turn), name="asked", daemon=True).start()

    def _answer(self, connection: socket.socket, turn: int) -> None:
        """One question; whatever is wrong with it concerns nobody but who asked."""
        try:
            with connection, contextlib.suppress(OSError, ValueError):
                connection.settimeout(WHO_WITHIN)
                question = read_json(_line(connection))
                what = question.get("do") if isinstance(question, dict) else None
                if what == "who":
                    answer: dict[str, Any] = {**self._about, "ending": self._guard.ending}
                elif what == "land":
                    pid, user = _peer(connection)
                    report = self._guard.hand_over(f"lab safe, by {user}, process {pid}")
                    answer = {"steps": [asdict(step) for step in report.steps], "locked": self._guard.locked()}
                else:
                    answer = {"error": "ask who or land"}
                connection.sendall(json.dumps(answer).encode() + b"\n")
        finally:
            self._turns.put(turn)


# ------------------------------------------------------------------ who asks
def owners(names: Iterable[str] | None = None) -> list[Owner]:
    """The guards that own one of these names, or all guards of this computer; each once."""
    addresses = _all_addresses() if names is None else [_address(name) for name in names]
    if not addresses:
        return []
    found = [owner for owner in _each(_owner, addresses) if owner is not None]
    return list({owner.guard or str(owner.pid): owner for owner in found}.values())


def demand_free(names: Iterable[str], ending_too: bool = False) -> None:
    """Raises RigLocked, naming the run, when a guard owns one of these names; one that is ending only with `ending_too`."""
    for owner in owners(names):
        if owner.ending and not ending_too:
            continue
        still = "is still landing" if owner.ending else "is in use"
        raise RigLocked(
            f"{owner.rig or 'the rig'} {still}: {owner}. Wait for its end, end it with Ctrl-C, or land it with `lab safe`"
        )


@dataclass(frozen=True)
class Answer:
    """What a guard has read back after landing its rig."""

    report: SafeReport
    locked: str
    """Why the rig is locked all the same; empty when it is free."""


@dataclass(frozen=True)
class Landed:
    """The answers of the guards that were asked; None from one that stands still."""

    answers: dict[Owner, Answer | None]

    @property
    def answered(self) -> list[tuple[Owner, Answer]]:
        """Those that did."""
        return [(owner, answer) for owner, answer in self.answers.items() if answer is not None]

    @property
    def silent(self) -> list[Owner]:
        """Those that did not."""
        return [owner for owner, answer in self.answers.items() if answer is None]

    @property
    def report(self) -> SafeReport:
        """All steps."""
        return SafeReport(tuple(step for _, answer in self.answered for step in answer.report.steps))

    @property
    def names(self) -> frozenset[str]:
        """All that those own who answered."""
        return frozenset().union(*(owner.names for owner, _ in self.answered))


def land(names: Iterable[str] | None = None) -> Landed:
    """Have every guard that owns one of these names, or every guard of this computer, land its rig."""
    found = owners(names)
    if not found:
        return Landed({})
    return Landed(dict(zip(found, _each(_landed, found, len(found)), strict=True)))


def _each(ask: Callable[[A], B], whom: Sequence[A], at_once: int = MOST_AT_ONCE) -> list[B]:
    """What each answers, asked at the same time."""
    answers: list[Any] = [None] * len(whom)
    waiting = list(range(len(whom)))[::-1]

    def go() -> None:
        with contextlib.suppress(IndexError):
            while True:
                i = waiting.pop()
                answers[i] = ask(whom[i])

    asking = [timing.Thread(target=go, name="ask") for _ in range(min(len(whom), at_once))]
    for thread in asking:
        thread.start()
    for thread in asking:
        thread.join()
    return answers


def _landed(owner: Owner) -> Answer | None:
    for name in sorted(owner.names):
        found = _ask(_address(name), {"do": "land"}, LAND_WITHIN)
        if found is not None:
            with contextlib.suppress(ValueError):
                return Answer(SafeReport.parsed(found[0].get("steps")), str(found[0].get("locked", ""))[:1000])
    return None


def _owner(address: str) -> Owner | None:
    found = _ask(address, {"do": "who"}, WHO_WITHIN)
    if found is None:
        return None
    said, pid, user = found
    names = said.get("names")
    names = frozenset(str(n) for n in names) if isinstance(names, list) else frozenset()
    texts = {key: str(said.get(key, ""))[:1000] for key in ("guard", "rig", "about")}
    return Owner(texts["guard"], pid, user, texts["rig"], names, texts["about"], said.get("ending") is True)


def _ask(address: str, question: dict[str, str], within: float) -> tuple[dict[str, Any], int, str] | None:
    """The answer, process and user of who gives it `within` host seconds; None when nobody is there. An owner that stands still
    says {}."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as connection:
        connection.settimeout(within)
        try:
            connection.connect(address)
            pid, user = _peer(connection)
            connection.sendall(json.dumps(question).encode() + b"\n")
            said = read_json(_line(connection))
        except TimeoutError:
            return {}, *_peer(connection)
        except (OSError, ValueError):
            return None
        return (said, pid, user) if isinstance(said, dict) else None


def _line(connection: socket.socket) -> bytes:
    """Up to the end of the line, of the connection, or of what is read of a hostile one."""
    data = b""
    while not data.endswith(b"\n") and len(data) < LONGEST and (more := timing.recv(connection, 4096)):
        data += more
    return data


def _peer(connection: socket.socket) -> tuple[int, str]:
    """Process and user at the other end, from the kernel."""
    pid, uid, _ = struct.unpack("3i", connection.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, 12))
    try:
        return pid, pwd.getpwuid(uid).pw_name
    except KeyError:
        return pid, str(uid)


def _address(name: str) -> str:
    return "\0" + PREFIX + hashlib.sha256(os.fsencode(name)).hexdigest()[:40]


def _all_addresses() -> list[str]:
    """The names of all guards of this computer, from the kernel's table of sockets (one line for each connection too)."""
    with open("/proc/net/unix", encoding="utf-8", errors="replace") as table:
        found = {line.rsplit(None, 1)[-1] for line in table if f" @{PREFIX}" in line}
    return ["\0" + name[1:] for name in sorted(found)]


def _bound(name: str) -> socket.socket | None:
    """A socket of that name, which listens; None when it is somebody else's."""
    taken = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    try:
        taken.bind(_address(name))
    except OSError as e:
        taken.close()
        if e.errno == errno.EADDRINUSE:
            return None
        raise
    taken.listen(MOST_AT_ONCE)
    return taken
