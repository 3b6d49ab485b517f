"""What a log says of its motors and their load."""

from __future__ import annotations

from motorprior.logs.doctor.findings import IN_MAP, Finding
from motorprior.logs.motor_log import MotorLog
from motorprior.logs.settings_text import settings_text


def load_given(log: MotorLog) -> list[Finding]:
    """Whether the log says what its motors moved, and how much it varies: largest over smallest inertia."""
    if log.load_inertia is None:
        message = "the log does not say what its motors moved"
        remedy = "`motorprior logs import` adds loads, with suspended or fit_load: docs/your-motors.md"
        return [Finding("info", "load_given", 0.0, None, message, remedy, row=0)]
    least, most = float(log.load_inertia.min()), float(log.load_inertia.max())
    message = f"load inertia {least:.3g} to {most:.3g} kg·m²"
    if log.external_torque is not None:
        message += f", external torque {log.external_torque.min():.3g} to {log.external_torque.max():.3g} N·m"
    return [Finding("info", "load_given", most / least, None, message, row=0)]


def stated(log: MotorLog) -> list[Finding]:
    """The gains, registers and postures that the log states: whoever fits motors to it takes them as given."""
    if told := settings_text(log):
        return [Finding("info", "stated", 1.0, None, f"the log states {told}", row=0)]
    remedy = f"state what you know by options of `motorprior logs import`, for every kind of file, or {IN_MAP}"
    return [Finding("info", "stated", 0.0, None, "the log states no gain, register or posture", remedy, row=0)]
