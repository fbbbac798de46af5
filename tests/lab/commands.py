"""Commands of `lab`: in this process, one in a process of its own, or several in one on a computer that is unlike this one."""

import json
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from typing import Any, NamedTuple

from lab.files.config import ConfigError
from tests.simulated.bench import raises

refused = partial(raises, ConfigError)
SOUND = (0, 3)
"""Exit codes of a command that did what was asked; 3 where it has something to say of it."""
COMMANDS = """
import contextlib, io, json, sys

lacking, commands = json.load(sys.stdin)
sys.modules.update(dict.fromkeys(lacking))
from lab.cli import main

done = []
for words in commands:
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        code = main(words)
    done.append((code, out.getvalue(), err.getvalue()))
json.dump(done, sys.__stdout__)
"""


@contextmanager
def command(*words: object) -> Iterator[subprocess.Popen[str]]:
    """In a process of its own, killed at the end."""
    program = subprocess.Popen(
        [sys.executable, "-m", "lab.cli", *map(str, words)], stdin=subprocess.DEVNULL, stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT, text=True,
    )  # fmt: skip
    try:
        yield program
    finally:
        program.kill()
        program.wait()


class Done(NamedTuple):
    """What a command ended with."""

    returncode: int
    out: str
    err: str

    @property
    def both(self) -> str:
        return self.out + self.err

    @property
    def flat(self) -> str:
        """All that it said, as words between single blanks."""
        return " ".join(self.both.split())

    @property
    def flat_out(self) -> str:
        return " ".join(self.out.split())

    @property
    def flat_err(self) -> str:
        return " ".join(self.err.split())

    @property
    def json(self) -> Any:
        return json.loads(self.out)


Cli = Callable[..., Done]
"""The fixture `cli`: runs a command, and fails the test unless it ends with `code`: a number, or several that will do."""


def run_there(
    commands: Sequence[Sequence[object]], env: Mapping[str, str] | None = None, lacking: Sequence[str] = ()
) -> list[Done]:
    """Each command once, with this environment (None: ours) and without these libraries."""
    asked = json.dumps([lacking, [[str(word) for word in words] for words in commands]])
    done = subprocess.run([sys.executable, "-c", COMMANDS], env=env, input=asked, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0 and "Traceback" not in done.stderr, done.stderr
    return [Done(*one) for one in json.loads(done.stdout)]
