"""The door of a guard: any program of this computer can ask here who owns a rig, and request its landing.

A guard owns names: one for the path of its rig.yaml, one for each line that only one program may use. Each name is an
abstract Unix socket, which the kernel keeps: it is exclusive, it belongs to no file that anybody could edit or delete, it
ends with its process, and every user of this computer may connect to it. Next to rig.yaml stands a second socket, a file, which
strangers cannot crowd and which a container reaches that shares the folder. The kernel says who is at either end: only root,
the same account and the owner of the rig's folder are believed.

A question is one line of JSON, `{"do": "who"}` or `{"do": "land"}`. The answer's first line says who the guard is; after
`land` a second one says what was read back when the rig had landed. This module needs neither rig.yaml nor any driver.
"""

from __future__ import annotations

import contextlib
import errno
import hashlib
import json
import os
import pwd
import secrets
import socket
import struct
from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, Protocol

import timing
from recordings.json_text import read_json

from .latch import RigLocked
from .messages import SafeReport

PREFIX = "softlab/rig/"
TAKE_WITHIN = 8.0
"""Host seconds to wait for an earlier guard that is still landing; it disconnects the arm, which takes 2 s."""
WHO_WITHIN = 2.0
"""Host seconds within which a live guard identifies itself; its program gives it up after the same silence."""
LAND_WITHIN = 30.0
"""Host seconds for a landing by another guard: longer than any landing takes."""
STRANGER_WITHIN = 1.0
"""Host seconds allowed for a question from an account that is not trusted."""
LONGEST = 100_000
"""Bytes of an answer that are read."""
LONGEST_QUESTION = 1000
"""Bytes of a question that are read."""
BACKLOG = 4096
"""Connections that wait in the kernel's queue, at most."""
MOST_STRANGERS = 64
"""Simultaneous connections of untrusted accounts; one more closes the oldest."""
MOST_AT_ONCE = 32
"""Connections accepted at one name before the next name is served."""
MOST_OPEN = 256
"""Owners that are asked at the same time."""
SLICE = 0.02
"""Host seconds between two tries to take a name that is about to be free, or to ask an owner whose queue is full."""
PACE = 0.005
"""Host seconds of pause after connections of untrusted accounts, so that their number cannot slow the guard."""
NOBODY_THERE = {errno.ECONNREFUSED, errno.ENOENT, errno.ENOTDIR, errno.ENAMETOOLONG, errno.ELOOP}
"""Errors of the kernel if no program listens; any other failure is no answer."""
CLOSED = {errno.EACCES, errno.EPERM}
"""Its errors for a file that this user may not use."""


BELIEVED = "only root, the same account and the owner of the rig's folder are believed"


class CannotBeAsked(RigLocked):
    """The rig's owner does not answer, or is not trusted."""


@dataclass(frozen=True)
class Owner:
    """The guard that owns a rig."""

    guard: str
    """Unique to the guard; empty when the owner does not answer."""
    pid: int = 0
    """From the kernel, as its user; 0 where that is not known, as of a process in another container."""
    user: str = "unknown"
    rig: str = ""
    names: frozenset[str] = frozenset()
    """All that it owns, see `names_of_path` and `lab.guard.instruments.exclusive`."""
    about: str = ""
    """The command that it serves, with its process and start; why it cannot be asked, where that is known."""
    ending: bool = False
    """Its program has ended: it lands, then it is gone."""
    uid: int = field(default=-1, compare=False)
    """Its account, see `user`; -1 where that is not known."""
    believed: bool = field(default=False, compare=False)
    """Its account is one of `believed_accounts`."""

    def __str__(self) -> str:
        served = self.about or "a program that does not answer"
        doubt = "" if self.believed else f" ({BELIEVED})"
        return f"{served}; its guard is process {self.pid or 'unknown'} of user {self.user}{doubt}"


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


def believed_accounts(rig: str | Path | None) -> frozenset[int]:
    """Accounts that are trusted about a rig: root, this account, and the owner of the rig's folder."""
    accounts = {0, os.getuid()}
    if rig:
        with contextlib.suppress(OSError):
            accounts.add(os.stat(os.path.dirname(os.path.realpath(rig))).st_uid)
    return frozenset(accounts)


@dataclass
class _Question:
    """A connection that has not asked yet."""

    until: float
    asker: str
    """Its user and process, from the kernel."""
    stranger: bool
    data: bytes = b""


class Door:
    """The names of one guard, and the thread that answers at them."""

    def __init__(self, names: Collection[str], guard: Guarding, rig: str = "", about: str = "") -> None:
        """`rig`: path of rig.yaml; `about`: the command that the guard serves. Both are answers to who owns the rig."""
        self._names, self._guard, self._rig = frozenset(names), guard, rig
        self._about = {"guard": f"{os.getpid()}-{id(self):x}", "rig": rig, "about": about, "names": sorted(names)}
        self._accounts = believed_accounts(rig)
        self._sockets: list[socket.socket] = []
        self._left = contextlib.ExitStack()
        self._asking: dict[socket.socket, _Question] = {}
        """The oldest first."""
        self._lock = timing.Lock()
        self._landing: list[socket.socket] | None = None
        """Clients that wait for the current landing."""

    def open(self, within: float = TAKE_WITHIN) -> None:
        """Own all names. Raises RigLocked for a living program's guard, after `within` host seconds for one that is ending."""
        deadline = timing.now() + within
        try:
            for address in _addresses(self._names):
                while not self._listens(address):
                    late = timing.now() > deadline
                    _demand_free(_asked([address], "who", self._rig), ending_too=late)
                    if late:
                        raise CannotBeAsked("a program that does not answer owns a name of the rig; end it first")
                    timing.sleep(SLICE)
        except BaseException:
            self.close()
            raise
        timing.Thread(target=self._serve, name="door", daemon=True).start()

    def close(self) -> None:
        """Give the names back."""
        self._sockets = []
        self._left.close()

    def _listens(self, address: str) -> bool:
        """Listen at an address; False when another program does. A file that cannot be written is not needed: True."""
        if not _is_file(address):
            listening = _bound(address)
        elif not _free(address):
            return False
        else:
            listening = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
            try:
                self._left.callback(_bind_file(listening, address))
            except OSError:
                listening.close()
                return True
        if listening is not None:
            listening.setblocking(False)
            self._sockets.append(self._left.enter_context(listening))
        return listening is not None

    # -- answering
    def _serve(self) -> None:
        """Accept and answer until the door is closed. One thread serves all; a silent client delays nobody."""
        while sockets := self._sockets.copy():
            try:
                ready = timing.readable([*sockets, *self._asking], SLICE)
            except (OSError, ValueError):  # closed meanwhile
                continue
            strangers = False
            for connection in ready:
                if connection in self._asking:
                    self._read(connection)
                else:
                    strangers |= self._accept(connection)
            for late in [line for line, question in self._asking.items() if timing.now() > question.until]:
                self._forget(late)
            if strangers:
                timing.sleep(PACE)
        for connection in list(self._asking):
            self._forget(connection)

    def _accept(self, listening: socket.socket) -> bool:
        """Accept the connections that wait; whether there were strangers (accounts that are not believed) among them."""
        strangers = False
        for _ in range(MOST_AT_ONCE):
            try:
                connection, _ = listening.accept()
            except BlockingIOError:
                break
            except OSError:  # closed, or out of file descriptors: silent connections are closed
                self._end_oldest_stranger()
                break
            connection.setblocking(False)
            pid, uid = peer(connection)
            stranger = uid not in self._accounts
            if stranger:
                strangers = True
                if sum(question.stranger for question in self._asking.values()) >= MOST_STRANGERS:
                    self._end_oldest_stranger()
            self._asking[connection] = _Question(timing.now() + WHO_WITHIN, f"{_user(uid)}, process {pid}", stranger)
            self._read(connection)
        return strangers

    def _end_oldest_stranger(self) -> None:
        for connection in [one for one, question in self._asking.items() if question.stranger][:1]:
            self._forget(connection)

    def _forget(self, connection: socket.socket) -> None:
        del self._asking[connection]
        connection.close()

    def _read(self, connection: socket.socket) -> None:
        """Read a question as it arrives, answer it once it is complete, then close; a wrong one is closed unanswered."""
        question = self._asking[connection]
        try:
            data = connection.recv(LONGEST_QUESTION)
            question.data += data
            if data and len(question.data) < LONGEST_QUESTION and not question.data.endswith(b"\n"):
                return
            self._answer(connection, question)
        except BlockingIOError:
            return
        except (OSError, ValueError):
            pass
        if connection in self._asking:
            self._forget(connection)

    def _answer(self, connection: socket.socket, question: _Question) -> None:
        """Say who the guard is; for `land` keep the connection until the rig has landed. Raises ValueError, OSError."""
        message = read_json(question.data)
        what = message.get("do") if isinstance(message, dict) else None
        if what not in ("who", "land"):
            connection.send(_as_line({"error": "ask who or land"}))
            return
        connection.send(_as_line({**self._about, "ending": self._guard.ending}))
        if what == "land":
            with self._lock:
                begins = self._landing is None
                self._landing = [*(self._landing or []), connection]
            del self._asking[connection]
            if begins:
                timing.Thread(target=self._land, args=(question.asker,), name="land", daemon=True).start()

    def _land(self, asker: str) -> None:
        """Land once, for all requests that arrive meanwhile."""
        answer: dict[str, Any] = {}
        try:
            report = self._guard.hand_over(f"lab safe, by {asker}")
            answer = {"steps": [asdict(step) for step in report.steps], "locked": self._guard.locked()}
        finally:
            with self._lock:
                waiting, self._landing = self._landing or [], None
            for connection in waiting:
                with connection, contextlib.suppress(OSError):
                    connection.send(_as_line(answer))


# ------------------------------------------------------------------ who asks
def owners(names: Iterable[str] | None = None, rig: str | Path | None = None) -> list[Owner]:
    """The guards that own one of these names, or all guards of this computer; each once. `rig` decides who is believed."""
    return list(_asked(None if names is None else _addresses(names), "who", rig))


def demand_free(names: Iterable[str], rig: str | Path | None = None) -> None:
    """Raises RigLocked, naming the run, when a guard owns one of these names that is not about to end."""
    _demand_free(owners(names, rig), ending_too=False)


def _demand_free(found: Iterable[Owner], ending_too: bool) -> None:
    for owner in found:
        if owner.ending and not ending_too:
            continue
        still = "is still landing" if owner.ending else "is in use"
        kind = RigLocked if owner.guard and owner.believed else CannotBeAsked
        raise kind(f"{owner.rig or 'the rig'} {still}: {owner}. Wait for its end, end it with Ctrl-C, or land it with `lab safe`")


@dataclass(frozen=True)
class LandingAnswer:
    """What a guard has read back after landing its rig."""

    report: SafeReport
    locked: str
    """Why the rig is locked all the same; empty when it is free."""


@dataclass(frozen=True)
class Landed:
    """The answers of the guards that were asked; None from one that does not respond."""

    answers: dict[Owner, LandingAnswer | None]

    @property
    def answered(self) -> list[tuple[Owner, LandingAnswer]]:
        """Those that did, and are trusted."""
        return [(owner, answer) for owner, answer in self.answers.items() if owner.believed and answer is not None]

    @property
    def silent(self) -> list[Owner]:
        """Those that did not, and belong to a trusted account."""
        return [owner for owner, answer in self.answers.items() if owner.believed and answer is None]

    @property
    def doubtful(self) -> list[Owner]:
        """Those that are not trusted, or that the kernel does not name."""
        return [owner for owner in self.answers if not owner.believed]

    @property
    def report(self) -> SafeReport:
        """All steps."""
        return SafeReport(tuple(step for _, answer in self.answered for step in answer.report.steps))

    def names_for(self, rig: Path) -> frozenset[str]:
        """All names owned by those that answered and are trusted about this rig."""
        accounts = believed_accounts(rig)
        return frozenset().union(*(owner.names for owner, _ in self.answered if owner.uid in accounts))


def land(names: Iterable[str] | None = None, rig: str | Path | None = None) -> Landed:
    """Have every guard that owns one of these names, or any of this computer, land its rig; `rig` decides who is believed."""
    return Landed(_asked(None if names is None else _addresses(names), "land", rig))


@dataclass
class _Talk:
    """One question at one address."""

    address: str
    what: str
    accounts: frozenset[int]
    """Those that are believed."""
    own_rig: bool
    """So is the owner of the folder of the rig that the guard names."""
    until: float
    """Time at which it times out."""
    again: float = 0.0
    """Time of the next try to connect."""
    line: socket.socket | None = None
    owner: Owner | None = None
    """The owner, as soon as it is known; None if nobody listens."""
    answer: LandingAnswer | None = None
    data: bytes = b""
    over: bool = False

    def connect(self) -> None:
        """Connect and ask; note who is there (`owner`), and whether it is over. What fails for now is tried again."""
        self.line = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        self.line.setblocking(False)
        try:
            _connect(self.line, self.address)
            pid, uid = peer(self.line)
            if self.owner is None or self.owner.uid < 0:
                believed = uid in self.accounts
                self.owner = Owner("", pid, _user(uid), uid=uid, believed=believed)
                self.until = timing.now() + WHO_WITHIN if believed else self.until - WHO_WITHIN + STRANGER_WITHIN
            self.line.send(_as_line({"do": self.what}))
        except OSError as e:
            self.hang_up()
            if e.errno in NOBODY_THERE:
                self.owner, self.over = None, True
            elif e.errno in CLOSED:  # it may be left over, or the door of a run in a container
                self.over = True
                self.owner = Owner("", about=f"whoever is behind {self.address}, which is closed to this user")
                self.owner = self.owner if self.what == "land" else None
            elif self.owner is None:
                self.owner = Owner("", about=f"a program that cannot be asked ({e.strerror})")

    def read(self) -> None:
        """Read what has arrived and act on each complete line; `over` once the answer is complete or invalid."""
        assert self.line is not None
        data = b""
        with contextlib.suppress(OSError):
            data = self.line.recv(LONGEST)
        self.data += data
        try:
            while b"\n" in self.data and not self.over:
                first, self.data = self.data.split(b"\n", 1)
                self._hear(read_json(first))
        except ValueError:
            self.over = True
        if not data:  # before the first answer this may be a crowded door: ask again, until nobody is there
            self.over = self.over or bool(self.owner and self.owner.guard)
            self.hang_up()
        self.over = self.over or len(self.data) > LONGEST

    def _hear(self, message: Any) -> None:
        """Take one line of the answer: first who the guard is, then what its landing reached. Raises ValueError for another."""
        owner = self.owner
        if owner is None or not isinstance(message, dict):
            raise ValueError("no answer")
        if owner.guard:
            self.answer = LandingAnswer(SafeReport.parsed(message.get("steps")), str(message.get("locked", ""))[:1000])
            self.over = True
            return
        names = message.get("names")
        guard, rig, served = (str(message.get(key, ""))[:1000] for key in ("guard", "rig", "about"))
        self.owner = replace(
            owner,
            guard=guard,
            rig=rig,
            names=frozenset(str(name) for name in names) if isinstance(names, list) else frozenset(),
            about=served,
            ending=message.get("ending") is True,
            believed=owner.believed or (self.own_rig and owner.uid in believed_accounts(rig)),
        )
        self.over = self.what == "who" or not guard
        if owner.believed:
            self.until = timing.now() + LAND_WITHIN

    def hang_up(self) -> None:
        """Close the line."""
        if self.line is not None:
            self.line.close()
        self.line, self.data, self.again = None, b"", timing.now() + SLICE


def _asked(addresses: Sequence[str] | None, what: str, rig: str | Path | None) -> dict[Owner, LandingAnswer | None]:
    """Ask these guards, or all of this computer, in parallel (`what`: who or land); each once, with its answer or None."""
    until, accounts, own_rig = timing.now() + WHO_WITHIN, believed_accounts(rig), addresses is None
    if addresses is None:  # the kernel's table of sockets has one line for each connection too
        with open("/proc/net/unix", encoding="utf-8", errors="replace") as table:
            found = {line.rsplit(None, 1)[-1] for line in table if f" @{PREFIX}" in line}
        addresses = ["\0" + name[1:] for name in sorted(found)]
    talks = [_Talk(address, what, accounts, own_rig, until) for address in addresses]
    open_talks = talks
    while open_talks:
        lines = {talk.line: talk for talk in open_talks if talk.line is not None}
        due = [talk for talk in open_talks if talk.line is None and timing.now() >= talk.again]
        for talk in due[: MOST_OPEN - len(lines)]:
            talk.connect()
            if talk.line is not None:
                lines[talk.line] = talk
        if lines:
            for line in timing.readable(list(lines), SLICE):
                lines[line].read()
        elif not all(talk.over for talk in open_talks):
            timing.sleep(SLICE)
        for talk in open_talks:
            if talk.over or timing.now() > talk.until:
                talk.over = True
                talk.hang_up()
        open_talks = [talk for talk in open_talks if not talk.over]
    return _each_once(talks)


def _each_once(talks: Sequence[_Talk]) -> dict[Owner, LandingAnswer | None]:
    """One owner for all its names, with what it answered at any; where it could not be asked at one, that one counts no more."""
    met = [(talk, talk.owner) for talk in talks if talk.owner is not None]
    answered = [(talk, owner) for talk, owner in met if talk.answer is not None or (talk.what == "who" and owner.guard)]
    theirs = {address for _, owner in answered if owner.believed for address in _addresses(owner.names)}
    found: dict[object, tuple[Owner, LandingAnswer | None]] = {}
    for talk, owner in [*answered, *((talk, owner) for talk, owner in met if talk.address not in theirs)]:
        found.setdefault((owner.uid, owner.guard or owner.pid or talk.address), (owner, talk.answer))
    return dict(found.values())


# ------------------------------------------------------------------ addresses
def _addresses(names: Iterable[str]) -> list[str]:
    """Where the owner of these names listens: abstract sockets, and the file next to rig.yaml."""
    names = sorted(names)
    paths = {os.path.realpath(name.removeprefix("path:")) for name in names if name.startswith("path:")}
    return [*(_address(name) for name in names), *(f"{path}.sock" for path in sorted(paths))]


def _address(name: str) -> str:
    return "\0" + PREFIX + hashlib.sha256(os.fsencode(name)).hexdigest()[:40]


def _is_file(address: str) -> bool:
    return not address.startswith("\0")


def _bound(name: str) -> socket.socket | None:
    """A listening socket of that name or address; None if another program has it."""
    listening = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    try:
        listening.bind(name if name.startswith("\0") else _address(name))
    except OSError as e:
        listening.close()
        if e.errno == errno.EADDRINUSE:
            return None
        raise
    listening.listen(BACKLOG)
    return listening


def _connect(line: socket.socket, address: str) -> None:
    """Connect, to a file by its descriptor: an address has at most 107 bytes, a path any number."""
    if not _is_file(address):
        line.connect(address)
        return
    file = os.open(address, os.O_PATH | os.O_NOFOLLOW | os.O_CLOEXEC)
    try:
        line.connect(f"/proc/self/fd/{file}")
    finally:
        os.close(file)


def listener(path: str, within: float = 0.0) -> int | None:
    """Process that listens at a socket of the file system, asked for `within` host seconds at most; None where none does. Raises
    OSError where that cannot be told, as for a file that this user may not use."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as line:
        line.settimeout(within)
        try:
            _connect(line, path)
        except OSError as e:
            if e.errno in NOBODY_THERE:
                return None
            raise
        return peer(line)[0]


def _free(path: str) -> bool:
    """Whether no program listens at this file, as far as this user may know."""
    try:
        return listener(path) is None
    except OSError as e:
        return e.errno in CLOSED


def _bind_file(listening: socket.socket, path: str) -> Callable[[], None]:
    """Listen at a file for this account and root; returns what removes it. It gets its name once it listens. Raises OSError."""
    place, name = os.path.split(path)
    folder = os.open(place, os.O_PATH | os.O_DIRECTORY | os.O_CLOEXEC)
    temporary = f".{secrets.token_hex(4)}.sock"

    def remove(which: str = name) -> None:
        with contextlib.suppress(OSError):
            if os.stat(which, dir_fd=folder, follow_symlinks=False).st_ino == inode:
                os.unlink(which, dir_fd=folder)
        os.close(folder)

    inode = 0
    try:
        listening.bind(f"/proc/self/fd/{folder}/{temporary}")
        inode = os.stat(temporary, dir_fd=folder, follow_symlinks=False).st_ino
        os.chmod(temporary, 0o600, dir_fd=folder)
        listening.listen(BACKLOG)
        os.rename(temporary, name, src_dir_fd=folder, dst_dir_fd=folder)
    except OSError:
        remove(temporary)
        raise
    return remove


def _as_line(message: dict[str, Any]) -> bytes:
    return json.dumps(message).encode() + b"\n"


def peer(connection: socket.socket) -> tuple[int, int]:
    """Process and account at the other end, from the kernel."""
    pid, uid, _ = struct.unpack("3i", connection.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, 12))
    return pid, uid


def _user(uid: int) -> str:
    try:
        return pwd.getpwuid(uid).pw_name
    except (KeyError, OverflowError):
        return str(uid) if uid >= 0 else "unknown"
