"""What can go wrong."""

from __future__ import annotations


class FleetError(Exception):
    """Everything that this package raises."""


class Refused(FleetError):
    """The gateway refused. `code` is one of its words, `message` says what and where."""

    def __init__(self, code: str, message: str) -> None:
        super().__init__(f"{code}: {message}")
        self.code = code
        self.message = message


class NoGateway(FleetError):
    """Nobody answers: no router there, no gateway, or another prefix."""


class TimedOut(FleetError):
    """What was waited for has not happened in time; it may happen yet."""
