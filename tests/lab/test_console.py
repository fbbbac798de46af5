"""Whatever a text holds, it is shown and does nothing: on the screen, in tables, in progress, in logs, on pages."""

import io
import os
import subprocess
import sys
import textwrap
from pathlib import Path
from types import SimpleNamespace

import pytest
from commands import Cli
from rich.table import Table
from terminal import Terminal

from drivers.errors import DeviceFault
from lab.console import PlainConsole, Screen, out, styled
from lab.files.config import ConfigError
from lab.guard.latch import Latch
from lab.pages.figures import STYLE, save
from lab.pages.report import Report
from lab.plain import plain
from lab.verbs import fakes, recorded

pytestmark = pytest.mark.usefixtures("drawn")

HOSTILE = "[/red] [bold]x[/] \x1b[2J\r\x07\0\u202e <script>alert(1)</script> :smile: \ud800 {{ 1 }}"
SHOWN = "[/red] [bold]x[/] \\x1b[2J\\r\\x07\\x00\\u202e <script>alert(1)</script> :smile: \\ud800 {{ 1 }}"


def test_plain_text_keeps_what_is_read_and_writes_out_what_acts() -> None:
    assert plain(HOSTILE) == SHOWN
    assert plain("naïve µ → 漢字 \t\n") == "naïve µ → 漢字 \t\n"
    assert plain("one\r\ntwo\x9b2J") == "one\ntwo\\x9b2J"


def test_out_prints_text_errors_and_paths_plain(capsys: pytest.CaptureFixture[str]) -> None:
    for thing in (HOSTILE, DeviceFault("valve", HOSTILE), Path(HOSTILE.replace("\0", ""))):
        out.print(thing, soft_wrap=True)
    assert capsys.readouterr().out.splitlines() == [SHOWN, f"valve: {SHOWN}", SHOWN.replace("\\x00", "")]


def test_a_table_shows_text_plain_in_every_place() -> None:
    table = Table(HOSTILE, title=HOSTILE, caption=HOSTILE)
    table.add_row(HOSTILE)
    table.add_row(styled(HOSTILE, "red"))
    text = io.StringIO()
    PlainConsole(file=text, width=400).print(table)
    assert text.getvalue().count(SHOWN) == 5


def test_the_screen_says_text_plain_and_shows_that_it_goes_on(capsys: pytest.CaptureFixture[str]) -> None:
    with Screen(HOSTILE) as screen:
        screen.say(f"{HOSTILE}\nsafe")
    said = capsys.readouterr().out
    assert "[/red] [bold]x[/] \\x1b[2J" in said and "\n    safe\n" in said


def program(text: str) -> tuple[str, ...]:
    return sys.executable, "-c", textwrap.dedent(text)


def ended(text: str, code: int = 0, **environment: str) -> subprocess.CompletedProcess[bytes]:
    """A program that has ended."""
    done = subprocess.run(program(text), capture_output=True, env=os.environ | environment, check=False)
    assert done.returncode == code, done.stderr.decode()
    return done


def test_progress_on_a_terminal_is_plain_names_its_step_with_the_share_and_stays_above_the_page_s_address() -> None:
    running = program(f"""
        from lab.console import Screen
        with Screen({HOSTILE!r}) as screen:
            screen.progress(1.0, 2.0)
            screen._progress.refresh()
            screen.say({HOSTILE!r})
        with Screen("weighing hypotheses") as screen:
            screen.step("step 2 of 5: hypotheses", 0.25)
            screen._progress.refresh()
        with Screen("a run") as screen:
            screen.watched("http://127.0.0.1:1/x/")
            screen.say("the last line")
    """)
    with Terminal(program=running) as terminal:
        assert terminal.end() == 0
    seen = terminal.raw
    assert seen.count(SHOWN) >= 2 and "\x1b[2J" not in seen and "\x07" not in seen
    assert "weighing hypotheses, step 2 of 5: hypotheses" in seen and "25 %" in seen
    assert seen.rindex("watch it at http://127.0.0.1:1/x/") > seen.index("the last line")


def test_where_no_bar_is_a_step_that_lasts_says_once_what_it_is_and_how_long_it_will_take(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    now = [0.0]
    monkeypatch.setattr("lab.console.time", SimpleNamespace(monotonic=lambda: now[0]))
    with Screen("weighing hypotheses") as screen, Screen("a run") as run, Screen("asked to be quiet", quiet=True) as quiet:
        for now[0], share in ((10.0, 0.1), (25.0, 0.2), (40.0, 0.4), (70.0, 0.8)):
            screen.step("step 2 of 5: hypotheses", share)
            run.progress(2 * now[0], 200.0)
            quiet.step("a step", share)
        now[0] = 130.0
        screen.step("step 3 of 5: the rest", 0.1)
        now[0] = 160.0
        screen.step("step 3 of 5: the rest", 1.0)
    said = ["a run: about 2 min left", "weighing hypotheses, step 2 of 5: hypotheses: about 45 s to 2 min left in this step"]
    assert capsys.readouterr().err.splitlines() == said


def test_the_address_of_the_page_is_printed_once_a_campaign(capsys: pytest.CaptureFixture[str]) -> None:
    with Screen("a campaign") as screen:
        for _ in range(3):
            screen.watched("http://127.0.0.1:2/y/")
    assert capsys.readouterr().out.count("http://127.0.0.1:2/y/") == 1


def test_an_error_that_ends_the_command_is_plain(monkeypatch: pytest.MonkeyPatch, cli: Cli, tmp_path: Path) -> None:
    def fail(files: object) -> int:
        raise DeviceFault("valve", HOSTILE)

    monkeypatch.setattr(recorded, "info", fail)
    assert cli("info", tmp_path, code=1).err == f"valve: {SHOWN}\n"


def test_a_mistake_in_the_program_and_the_logs_of_libraries_are_told_plain() -> None:
    said = ended(f"""
        import logging
        from lab.console import plain_failures
        plain_failures()
        logging.getLogger("library").error({HOSTILE!r})
        raise ZeroDivisionError({HOSTILE!r})
    """, code=1).stderr.decode()  # fmt: skip
    assert f"library: {SHOWN}" in said and f"ZeroDivisionError: {SHOWN}" in said and "\x1b" not in said


def test_a_character_that_the_terminal_does_not_have_ends_nothing() -> None:
    done = ended("""
        from lab.console import Screen, plain_failures
        plain_failures()
        Screen("title").say("25 °C 漢")
    """, PYTHONIOENCODING="ascii")  # fmt: skip
    assert done.stdout == b"  25 \\xb0C \\u6f22\n"


def test_a_reader_that_has_gone_does_not_end_the_program() -> None:
    text = """
        import sys
        from lab.console import Screen, out
        sys.stdin.readline()
        for i in range(3):
            out.print("nobody reads this")
            Screen("title").say("nor this")
        print("went on", file=sys.stderr)
    """
    pipe = subprocess.PIPE
    with subprocess.Popen(program(text), stdin=pipe, stdout=pipe, stderr=pipe, text=True) as process:
        assert process.stdout and process.stdin and process.stderr
        process.stdout.close()
        process.stdin.write("\n")
        process.stdin.close()
        assert process.stderr.read() == "went on\n"
    assert process.returncode == 0


def test_a_page_shows_text_and_runs_none_of_it(tmp_path: Path) -> None:
    report = Report(HOSTILE, HOSTILE, HOSTILE)
    picture = tmp_path / "p.png"
    picture.write_bytes(b"png")
    report.section(HOSTILE).text(HOSTILE).table([HOSTILE], [[HOSTILE]]).figure(picture, f'"{HOSTILE}')
    page = report.write(tmp_path / "page.html").read_text(encoding="utf-8")
    assert "<script" not in page and page.count("&lt;script&gt;alert(1)&lt;/script&gt;") == 10
    assert "\x1b" not in page and "\u202e" not in page and "\\x1b[2J" in page and "{{ 1 }}" in page


def test_a_figure_draws_text_that_looks_like_mathematics(tmp_path: Path) -> None:
    import matplotlib.pyplot as plt

    with plt.rc_context(STYLE):
        figure, axis = plt.subplots()
        axis.set_title(r"$\frac{1} costs $5 [/red]")
        assert save(figure, tmp_path / "a.png").stat().st_size > 1000


def test_the_guard_s_journal_has_one_line_for_a_text(tmp_path: Path) -> None:
    latch = Latch(tmp_path / "rig.yaml")
    latch.note(f"{HOSTILE}\nall is well")
    (line,) = latch.journal.read_text(encoding="utf-8").splitlines()
    assert line.endswith(f"{SHOWN}\\nall is well")


class Shown(io.StringIO):
    """What stands at a terminal."""

    def isatty(self) -> bool:
        return True


@pytest.mark.parametrize(("file", "lines"), [(Shown(), 1), (io.StringIO(), 0)])
def test_fakes_say_at_a_terminal_that_they_start_before_they_do(
    file: io.StringIO, lines: int, monkeypatch: pytest.MonkeyPatch, cli: Cli
) -> None:
    def compiling(a: object) -> None:
        assert file.getvalue().count("Starting the fakes") == lines
        raise ConfigError("enough")

    monkeypatch.setattr(fakes, "err", PlainConsole(file=file, width=200))
    monkeypatch.setattr(fakes, "_rig", compiling)
    cli("fakes", code=2)
    assert file.getvalue().count("\n") == lines
