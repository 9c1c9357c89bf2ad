"""What a job is made of. Ways in steps, speeds in Hz, accelerations in steps/s², jerks in steps/s³.

Each function returns the JSON of one command; what is out of range is refused by the gateway, with its
place.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, TypeAlias

Command: TypeAlias = dict[str, dict[str, Any]]


def _given(**fields: Any) -> dict[str, Any]:
    return {name: value for name, value in fields.items() if value is not None}


def move(*, axis: int, delay_us: int, steps: int) -> Command:
    """`steps` pulses (with sign), `delay_us` apart, without a ramp."""
    return {"move": {"axis": axis, "delay_us": delay_us, "steps": steps}}


def sync_move(*, delay_us: tuple[int, int], steps: tuple[int, int]) -> Command:
    """Two moves of axes 0 and 1 that start on the same tick."""
    return {"sync_move": {"delay_us": list(delay_us), "steps": list(steps)}}


def ramp(
    *,
    axis: int,
    steps: int,
    speed_hz: int,
    accel: int,
    jerk: int | None = None,
    linear_steps: int | None = None,
    jump_steps: int | None = None,
) -> Command:
    """A relative move with ramps."""
    return {
        "ramp": _given(
            axis=axis,
            steps=steps,
            speed_hz=speed_hz,
            accel=accel,
            jerk=jerk,
            linear_steps=linear_steps,
            jump_steps=jump_steps,
        )
    }


def ramp_to(
    *,
    axis: int,
    position: int,
    speed_hz: int,
    accel: int,
    jerk: int | None = None,
    linear_steps: int | None = None,
    jump_steps: int | None = None,
) -> Command:
    """A move to a position, with ramps."""
    return {
        "ramp_to": _given(
            axis=axis,
            position=position,
            speed_hz=speed_hz,
            accel=accel,
            jerk=jerk,
            linear_steps=linear_steps,
            jump_steps=jump_steps,
        )
    }


def smooth_ramp(
    *, axis: int, steps: int, start_hz: int, speed_hz: int, ramp_steps: int
) -> Command:
    """A relative move whose speed goes by 3x² - 2x³ over `ramp_steps`, as ESP-IDF's smoothstep."""
    return {
        "smooth_ramp": {
            "axis": axis,
            "steps": steps,
            "start_hz": start_hz,
            "speed_hz": speed_hz,
            "ramp_steps": ramp_steps,
        }
    }


def smooth_ramp_to(
    *, axis: int, position: int, start_hz: int, speed_hz: int, ramp_steps: int
) -> Command:
    """The same to a position."""
    return {
        "smooth_ramp_to": {
            "axis": axis,
            "position": position,
            "start_hz": start_hz,
            "speed_hz": speed_hz,
            "ramp_steps": ramp_steps,
        }
    }


def line(*, steps: Sequence[int], speed_hz: int, accel: int, jerk: int | None = None) -> Command:
    """All axes start and end together; speed and acceleration are those of the axis with most steps."""
    return {"line": _given(steps=list(steps), speed_hz=speed_hz, accel=accel, jerk=jerk)}


def pause(*, ms: int) -> Command:
    """All axes rest."""
    return {"pause": {"ms": ms}}


def laser(*, power_percent: int) -> Command:
    """Power of the laser for what follows, 0 to 100."""
    return {"laser": {"power_percent": power_percent}}


def lidar_read() -> Command:
    """A lidar reading."""
    return {"lidar_read": {}}


def home(*, axis: int) -> Command:
    """Finds the axis' reference switch."""
    return {"home": {"axis": axis}}


def set_position(*, axis: int, position: int) -> Command:
    """Names the place where the axis is, without motion."""
    return {"set_position": {"axis": axis, "position": position}}


def barrier(*, name: str) -> Command:
    """A meeting point of a synchronized job."""
    return {"barrier": {"name": name}}
