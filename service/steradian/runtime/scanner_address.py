"""Port of the scanner: the configured port or that of a simulator."""

from __future__ import annotations

from contextlib import ExitStack

from steradian.core.settings import Settings


class ScannerConnection:
    """Port of the scanner; a simulated scanner is started on first use and restarted after a failure."""

    def __init__(self, settings: Settings) -> None:
        self._settings, self._stack, self._url = settings, ExitStack(), ""

    def present(self) -> str | None:
        """Return the port's address; ``None`` while the simulated scanner is not started."""
        return (self._url or None) if self._settings.simulated else self._settings.scanner

    def url(self) -> str:
        """Return the port's address, starting the simulated scanner if necessary."""
        if not self._settings.simulated:
            return self._settings.scanner
        if not self._url:
            from fabry_perot.simulator import launch

            self._url = self._stack.enter_context(launch(speed=self._settings.simulator_speed)).url
        return self._url

    def close(self) -> None:
        """Stop the simulated scanner."""
        self._url = ""
        self._stack.close()
