"""Ctrl-C, SIGTERM and SIGHUP at any moment: one sentence, exit code 1, nothing half-written, nobody left behind."""

import os
import re
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from hjprofile.interrupts import SIGNALS, answered

pytestmark = pytest.mark.skipif(not Path("/proc/self/task").is_dir(), reason="needs /proc")
NAMES = [s.name for s in SIGNALS]
SAID = re.compile(r"hjprofile: interrupted(; | at t = )[^\n]* \(see: hjprofile explain [\w-]+\)\n")
MAIN = "from hjprofile.cli import main\nprint('main', flush=True)\nmain()\n"
LEAVE = "from hjprofile.interrupts import *\nimport os, signal, sys, time\n"
END = "leave_when_asked('asked')\n"


def descendants(pid):
    try:
        tasks = [(task / "children").read_text() for task in Path(f"/proc/{pid}/task").iterdir()]
    except OSError:
        return []
    children = [int(child) for text in tasks for child in text.split()]
    return children + [pid for child in children for pid in descendants(child)]


def alive(pid):
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def stopped(folder, arguments, number, when, group=False):
    """Sends a signal to a command that has begun, when `when` is through; the seconds it took, None if it had ended."""
    environment = os.environ | {"NUMBA_CACHE_DIR": str(folder / "cache")}
    command = [sys.executable, "-c", MAIN, *arguments]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    with subprocess.Popen(command, cwd=folder, env=environment, start_new_session=True, **pipes) as process:
        assert process.stdout.readline() == "main\n"
        when(process)
        children, sent = descendants(process.pid), time.monotonic()
        if process.poll() is not None:
            return None
        (os.killpg if group else os.kill)(process.pid, number)
        _, err = process.communicate(timeout=60)
    seconds = time.monotonic() - sent
    if process.returncode == 0:  # it was done when the signal came
        return None
    assert process.returncode == 1 and SAID.fullmatch(err.replace("hjprofile: compiling (once)\n", "")), err
    while any(map(alive, children)):
        assert time.monotonic() < sent + 60.0
        time.sleep(0.02)
    assert not [path for path in folder.rglob(".*") if re.fullmatch(r"\..+\.[0-9a-f]{8}", path.name)]
    return seconds


def after(seconds):
    return lambda process: time.sleep(seconds)


def test_at_the_start(tmp_path):
    for number, seconds in zip(SIGNALS, (0.01, 0.1, 0.3), strict=False):
        stopped(tmp_path, ["run", "two_kinks"], number, after(seconds), group=True)


@pytest.mark.parametrize(
    "arguments",
    [["run"], pytest.param(["sweep", "--vary", "time.end=1,2,3", "--workers", "2"], marks=pytest.mark.slow)],
)
def test_while_loops_are_compiled(tmp_path, arguments):
    """The first of them is on disk, and the longest, of seconds on any machine, has begun or is about to."""

    def compiling(process):
        while not list(tmp_path.rglob("*.kernel")) and process.poll() is None:
            time.sleep(0.02)
        time.sleep(0.5)

    seconds = stopped(tmp_path, [arguments[0], "two_kinks", *arguments[1:]], signal.SIGTERM, compiling)
    assert seconds is not None and seconds < 5.0  # 0.2 s and 0.6 s; all of them take 10 s and more


@pytest.mark.slow
@pytest.mark.parametrize("number", NAMES)
@pytest.mark.parametrize(
    ("arguments", "longest"),
    [
        (["run", "two_kinks"], 16.0),
        (["run", "two_kinks", "--cells", "60000"], 16.0),
        (["check", "travelling_kink"], 10.0),
        (["sweep", "two_kinks", "--vary", "time.end=1,2,3,3.5", "--workers", "2"], 10.0),
    ],
    ids=["run", "long run", "check", "sweep"],
)
def test_at_any_moment(tmp_path, arguments, longest, number):
    """Compiled by the first, loaded by those after it, more often early than late."""
    for cold in (True, False):
        for i in range(8):
            folder = tmp_path / str(i) if cold else tmp_path
            folder.mkdir(exist_ok=True)
            stopped(folder, arguments, signal.Signals[number], after(0.01 + longest * (i / 8) ** 2), group=i % 2 == 0)


def run(script):
    done = subprocess.run([sys.executable, "-c", LEAVE + script], capture_output=True, text=True, timeout=60)
    return done.returncode, done.stdout, done.stderr


@pytest.mark.parametrize(
    ("script", "outcome"),
    [
        # whatever the main thread is at, what was begun is undone, the last first
        (END + "with undone(lambda: print('first')), undone(lambda: print('last', flush=True)):\n"
         "    os.kill(os.getpid(), signal.SIGTERM)\n    while True: pass", (1, "last\nfirst\n", "asked\n")),
        # what fails to be undone, and what takes too long
        (END + "with undone(lambda: 1 / 0):\n    signal.raise_signal(signal.SIGHUP)\n    time.sleep(60)",
         (1, "", "asked\n")),
        (END + "with undone(lambda: time.sleep(60)):\n    signal.raise_signal(signal.SIGINT)\n    time.sleep(60)",
         (1, "", "asked\n")),
        # before there is anybody who waits
        ("pipe = os.pipe\ndef early():\n    signal.raise_signal(signal.SIGINT)\n    return pipe()\nos.pipe = early\n"
         + END + "time.sleep(60)", (1, "", "asked\n")),
        # what is ignored from the start, as under nohup, or at the end
        ("signal.signal(signal.SIGHUP, signal.SIG_IGN)\n" + END + "signal.raise_signal(signal.SIGHUP)\n"
         "with answered(print): signal.raise_signal(signal.SIGHUP)\ntime.sleep(0.3)", (0, "", "")),
        (END + "heed_no_more()\n[signal.raise_signal(s) for s in SIGNALS]\ntime.sleep(0.3)", (0, "", "")),
        # the first is answered, by the main thread; the second ends the process
        (END + "with answered(lambda number, _: print(number, flush=True)):\n    signal.raise_signal(signal.SIGTERM)\n"
         "    time.sleep(0.3)\n    signal.raise_signal(signal.SIGTERM)\n    time.sleep(60)", (1, "15\n", "asked\n")),
    ],
    ids=["undone", "not undone", "too long", "early", "nohup", "at the end", "second"],
)  # fmt: skip
def test_a_process_that_is_asked_to_end(script, outcome):
    assert run(script) == outcome


def test_half_a_file_is_removed(tmp_path):
    script = (
        "from pathlib import Path\nfrom hjprofile.files import write_whole\n"
        f"os.fsync = lambda _: (os.kill(os.getpid(), signal.SIGTERM), time.sleep(60))\nos.chdir({str(tmp_path)!r})\n"
        "write_whole(Path('file'), 'whole')"
    )
    assert run(END + script) == (1, "", "asked\n") and not list(tmp_path.iterdir())


def test_signals_are_as_before():
    """Within a program of somebody's own: also after an error, and from a thread of it, which may set none."""
    before = {s: signal.getsignal(s) for s in SIGNALS}
    heard = []
    with pytest.raises(ZeroDivisionError), answered(lambda number, _: heard.append(number)):
        signal.raise_signal(signal.SIGTERM)
        assert heard == [signal.SIGTERM] and signal.getsignal(signal.SIGTERM) == before[signal.SIGTERM]
        raise ZeroDivisionError
    assert {s: signal.getsignal(s) for s in SIGNALS} == before

    def elsewhere():
        with answered(print):
            heard.append({s: signal.getsignal(s) for s in SIGNALS})

    thread = threading.Thread(target=elsewhere)
    thread.start()
    thread.join()
    assert heard[1] == before


@pytest.mark.parametrize(
    "closed", [*(pytest.param(one, marks=pytest.mark.slow) for one in ("<&-", "2>&-")), ">&-", "<&- >&- 2>&-"]
)
def test_a_stream_that_is_closed(closed):
    """What is said goes nowhere, and into no file that has got its number."""
    script = f'"$0" -m hjprofile cases {closed}; test $? = 0 && "$0" -m hjprofile run nix {closed}'
    done = subprocess.run(["sh", "-c", script, sys.executable], capture_output=True, text=True)
    assert done.returncode == 2 and (">&-" not in closed or "Traceback" not in done.stderr)
