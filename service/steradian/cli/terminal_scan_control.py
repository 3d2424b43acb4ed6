"""Ctrl-C (SIGINT), SIGTERM and SIGHUP handling for a scan started from a terminal."""

from __future__ import annotations

import os
import select
import shlex
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from steradian.cli.console import ProgressBar, path_with_size, print_stderr
from steradian.cli.stage_options import describe_proposal, parse_choice
from steradian.core.exceptions import InvalidInput, ScanFailed
from steradian.core.signal_safe_event import EXIT_INTERRUPTED, SignalSafeEvent
from steradian.scans.acquisition.session_control import Command, SessionControl, SessionOutcome, SessionPhase

if TYPE_CHECKING:
    from steradian.plans.stages import Points, Proposal
    from steradian.scans.acquisition.run import ScanSummary

ANSWER_DELAY = 0.2
"""Seconds after Ctrl-C until the waiting message is printed."""
_SHOW_CURSOR = "\x1b[?25h"
_HANGUP = getattr(signal, "SIGHUP", None)
"""Signal of a closed terminal or ssh connection; not available on Windows."""


class TerminalScanControl(SessionControl):
    """Scan control that stops laser and scan at the first Ctrl-C and exits the process at the second.

    Parameters
    ----------
    file
        The scan file.
    options
        Options of ``scan resume`` to print in the hint for resumption.
    """

    def __init__(self, file: Path, options: tuple[str, ...] = ()) -> None:
        super().__init__()
        self._file, self._options = file, options
        self._existed = file.exists()
        self._stop, self._answered = SignalSafeEvent(), threading.Event()
        self._under_way = self._laser_is_off = False
        self._terminals = [number for number in (1, 2) if os.isatty(number)]
        self._bar: ProgressBar | None = None
        self._proposals: tuple[Proposal, ...] = ()
        self._at_end_of_input = False

    def attach_progress_bar(self, bar: ProgressBar) -> None:
        """Set the progress bar that shows the scan."""
        self._bar = bar
        bar("connecting", 0, 1)

    def command(self) -> Command:
        """Return the command to the session: SHUTDOWN after Ctrl-C, else RUN."""
        return Command.SHUTDOWN if self._stop.is_set() else Command.RUN

    @property
    def can_ask(self) -> bool:  # type: ignore[override]
        """Whether a person at the terminal can answer."""
        return not self._at_end_of_input and sys.stdin.isatty()

    def on_enough(self, reason: str) -> None:
        """Print why the scan has enough points."""
        if self._bar is not None:
            self._bar.say(reason)

    def on_proposals(self, number: int, proposals: tuple[Proposal, ...]) -> None:
        """Print the proposals for the points of interest of a stage."""
        self._proposals = proposals
        if self._bar is None:
            return
        for place, proposal in enumerate(proposals, start=1):
            self._bar.say(f"{place}: {describe_proposal(proposal)}")
        if not proposals:
            self._bar.say("nothing stands above the noise of the survey's image")

    def on_phase(self, phase: SessionPhase) -> None:
        """Record that the session has started, and ask for points of interest if the session waits for them."""
        if not self._under_way and self._bar is not None:
            self._bar("connecting", 1, 1)
        self._under_way = True
        if phase is SessionPhase.DECIDING and self._bar is not None:
            self._bar.say("laser off; choose: numbers such as 1 or 1,2, or a place such as 2.6mm,-1.8mm,2mm")

    def decide(self, number: int, proposed: Points) -> tuple[Points, str] | None:
        """Return the proposed points, or those typed at the terminal; ``None``: nothing is typed yet."""
        if proposed or not self.can_ask or not select.select([sys.stdin], [], [], 0)[0]:
            return super().decide(number, proposed)
        said = sys.stdin.readline()
        self._at_end_of_input = not said
        if not said.strip():
            return None
        try:
            chosen = parse_choice(said.strip(), self._proposals)
        except InvalidInput as error:
            if self._bar is not None:
                self._bar.say(str(error))
            return None
        return chosen, "terminal"

    def on_laser_off(self) -> None:
        """Record that the scanner has confirmed that its laser is off."""
        self._laser_is_off = True

    def progress(self, done: int, total: int) -> None:
        """Show the number of stored A-lines in the progress bar."""
        if self._bar is not None:
            self._bar("A-lines", done, total)

    def wait(self, seconds: float) -> None:
        """Wait for a time in seconds, or until a stop signal arrives."""
        self._stop.wait(seconds)

    def on_signal(self, number: int, _frame: object) -> None:
        """Handle a signal: the first requests a stop, a second exits at once, unless it is a repeated SIGHUP."""
        if number == _HANGUP:
            self._let_terminals_go()
        if self._stop.is_set():
            if number == _HANGUP:
                return
            self._leave_at_once()
        self._stop.set()
        if not self._under_way:
            raise KeyboardInterrupt

    def _let_terminals_go(self) -> None:
        """Redirect output from a closed terminal to the null device, because failed output would abort the scan."""
        gone = [number for number in self._terminals if not os.isatty(number)]
        for number in gone:
            nowhere = os.open(os.devnull, os.O_WRONLY)
            os.dup2(nowhere, number)
            os.close(nowhere)

    def _leave_at_once(self) -> None:
        """Exit the process immediately; the scan file is valid at every moment."""
        cursor = _SHOW_CURSOR if sys.stderr.isatty() else ""
        kept = f"what was stored is kept in {self._file}"
        told = f"{cursor}\nleaving at once: {kept}; the laser goes off when its lease ends\n"
        os.write(2, told.encode())
        os._exit(EXIT_INTERRUPTED)

    def print_waiting_message(self) -> None:
        """Print the reason if the scan does not end promptly after Ctrl-C; runs in its own thread."""
        self._stop.wait()
        if self._answered.wait(ANSWER_DELAY) or self._bar is None:
            return
        if self._laser_is_off:
            self._bar.say("laser off; storing the A-lines still in the scanner (Ctrl-C again exits at once)")
        else:
            self._bar.say(
                "stopping: the scanner has not confirmed yet that its laser is off; without us its lease ends in "
                "half a second (Ctrl-C again leaves at once)"
            )

    def end(self, summary: ScanSummary) -> None:
        """Print the result of a scan stopped by Ctrl-C and exit; return if the scan completed or was not stopped."""
        self._answered.set()
        if self._stop.is_set() and summary.end is not SessionOutcome.COMPLETE:
            if not self._file.exists():  # the connection ended before there was one
                self.report_early_stop()
            print_stderr(f"{self._laser()}; {self._stored(summary.stored, summary.points)}")
            raise typer.Exit(EXIT_INTERRUPTED)

    def report_failure(self) -> None:
        """Print the number of stored A-lines after a scanner failure; exit if Ctrl-C had requested the stop."""
        self._answered.set()
        if not self._under_way:
            return
        stopped = self._stop.is_set()
        print_stderr(f"{self._laser()}; {self._count()}" if stopped else self._count())
        if stopped:
            raise typer.Exit(EXIT_INTERRUPTED)

    def report_early_stop(self) -> None:
        """Print the result of a Ctrl-C before the session began, and exit."""
        self._answered.set()
        if self._existed:
            print_stderr(f"stopped before the scan continued; {self._count()}")
        else:
            self._file.unlink(missing_ok=True)  # without an A-line
            print_stderr("stopped before the scan began; nothing is written")
        raise typer.Exit(EXIT_INTERRUPTED)

    def close(self) -> None:
        """End the thread that prints the waiting message."""
        self._answered.set()
        self._stop.set()

    def _laser(self) -> str:
        return "laser off" if self._laser_is_off else "the scanner did not confirm, its laser's lease has run out"

    def _count(self) -> str:
        from steradian.scans.file.writer import ScanFileWriter

        with ScanFileWriter(self._file) as store:
            return self._stored(store.stored, store.count)

    def _stored(self, stored: int, points: int) -> str:
        command = shlex.join(["steradian", "scan", "resume", str(self._file), *self._options])
        return f"{stored:,} of {points:,} stored in {path_with_size(self._file)}; go on with: {command}"


@contextmanager
def terminal_scan_control(file: Path, options: tuple[str, ...] = ()) -> Iterator[TerminalScanControl]:
    """Handle Ctrl-C, SIGTERM and SIGHUP for a scan during the block, unless the parent process had them ignored."""
    control = TerminalScanControl(file, options)
    numbers = (signal.SIGINT, signal.SIGTERM, *(() if _HANGUP is None else (_HANGUP,)))
    before = {number: signal.getsignal(number) for number in numbers}
    heard = [number for number, handler in before.items() if handler is not signal.SIG_IGN]
    threading.Thread(target=control.print_waiting_message, name="answer", daemon=True).start()
    for number in heard:
        signal.signal(number, control.on_signal)
    try:
        yield control
    except KeyboardInterrupt:
        control.report_early_stop()
    except ScanFailed:
        control.report_failure()
        raise
    finally:
        control.close()
        for number in heard:
            signal.signal(number, before[number])
