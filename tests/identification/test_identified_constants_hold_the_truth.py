"""Constants that a fit calls identified have the truth in their intervals."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

import motorprior as mp
from motorprior.logs.load_log import load_log
from motorprior.logs.operations import smooth_on_grid
from motorprior.progress import Note, Progress

GRAVITY_TORQUE = 0.6  # of the link at the horizontal [N·m]
LINK_INERTIA = 0.02  # [kg·m²]
STEP = 0.00025  # of the simulation [s]
ENCODER_STEP = 2.0 * np.pi / 4096  # [rad]


@dataclass(frozen=True)
class Servo:
    """A servo with a rigid gear on a pendulum."""

    kp: float
    kd_over_kp: float = 0.03
    delay: float = 0.006
    armature: float = 0.02
    coulomb: float = 0.15
    viscous_damping: float = 0.27

    def angles(self, target: np.ndarray, rate: float) -> np.ndarray:
        """(rows,) angles [rad] at the times of the commands [rad]."""
        inertia = LINK_INERTIA + self.armature
        friction_step = STEP * self.coulomb / inertia
        pos = target[0]
        vel = 0.0
        angles = np.empty_like(target)
        step = 0
        for row in range(len(target)):
            angles[row] = pos
            while step * STEP < (row + 1) / rate - 1e-9:
                sent = max(0, int((step * STEP - self.delay) * rate + 1e-9))
                torque = self.kp * (target[sent] - pos) - self.kp * self.kd_over_kp * vel
                torque -= self.viscous_damping * vel + GRAVITY_TORQUE * np.cos(pos)
                free = vel + STEP / inertia * torque
                vel = np.sign(free) * max(abs(free) - friction_step, 0.0)
                pos += STEP * vel
                step += 1
        return angles


def log_of(servo: Servo, rate: float, seconds: float, seed: int = 0) -> mp.MotorLog:
    """Sines up to 3 Hz and steps, logged at ``rate`` [Hz] without gains."""
    rng = np.random.default_rng(seed)
    time = np.arange(round(seconds * rate)) / rate
    frequency = np.exp(rng.uniform(np.log(0.3), np.log(3.0), 4))
    waves = np.sin(2.0 * np.pi * (frequency * time[:, None] + rng.random(4))).sum(axis=1)
    steps = rng.uniform(-0.4, 0.4, int(seconds) + 1)[time.astype(int)]
    target = 0.1 * waves + steps * (time.astype(int) % 3 == 0)
    angles = servo.angles(target, rate)
    log = mp.MotorLog(
        time=time,
        position_target=target[:, None],
        joint_pos=ENCODER_STEP * np.round(angles / ENCODER_STEP)[:, None],
        joint_names=("swing",),
        robot="pendulum",
        motor="simulated servo",
        source="simulation",
    )
    on_grid = smooth_on_grid(log, 0.002)
    pos = on_grid.joint_pos
    return mp.MotorLog(
        **(
            vars(on_grid)
            | {
                "load_inertia": np.full(pos.shape, LINK_INERTIA),
                "external_torque": -GRAVITY_TORQUE * np.cos(pos),
                "load_stiffness": GRAVITY_TORQUE * np.sin(pos),
            }
        )
    )


def claimed_wrongly(prior: mp.MotorPrior, servo: Servo) -> list[str]:
    """Constants that are called identified and whose intervals miss the truth."""
    wrong = []
    for row in prior.constants():
        truth = getattr(servo, row.name, None)
        if truth is None or row.estimate is None or not row.identifiable:
            continue
        if not row.estimate.low <= truth <= row.estimate.high:
            wrong.append(f"{row}, truth {truth:.3g}")
    return wrong


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1])
def test_a_stiff_servo_has_no_constant_that_is_claimed_wrongly(seed: int):
    servo = Servo(kp=263.0)
    prior = mp.fit_prior(log_of(servo, rate=100.0, seconds=12.0), "quick", seed)

    assert claimed_wrongly(prior, servo) == []


@pytest.mark.slow
def test_a_soft_servo_in_rich_motion_is_identified():
    servo = Servo(kp=20.0)
    prior = mp.fit_prior(log_of(servo, rate=200.0, seconds=12.0), "quick")

    assert claimed_wrongly(prior, servo) == []
    assert prior.constants()["kp"].identifiable
    # noise of reading is most of the loss, so that other torques allow other delays
    delay = prior.constants()["delay"].estimate
    assert delay is not None
    assert delay.low <= servo.delay <= delay.high <= 3.0 * delay.low


@pytest.mark.slow
def test_intervals_of_a_gear_with_play_hold_the_truth(shared_data: Path):
    """The encoder is on the output: the PD hunts within the play, which free runs do not replay."""
    folder = shared_data / "cases" / "28-backlash-output-encoder"
    log = load_log(folder / "log.csv", columns=folder / "map.toml")

    intervals = mp.fit_prior(log, "quick").intervals()

    for name, truth in {"backlash": 0.0175, "gear_stiffness": 150.0, "coulomb": 0.08}.items():
        low, high = intervals[name][:, 0]
        assert low <= truth <= high, name


@pytest.mark.slow
def test_a_controller_that_compensates_gravity_leaves_the_scale_of_torques_open(
    shared_data: Path,
):
    """Without gains the joint seems not to sag under its load: kp is 40 N·m/rad, not thousands."""
    folder = shared_data / "cases" / "19-gravity-compensated"
    log = load_log(folder / "log.csv", columns=folder / "map_nokp.toml")
    notes: list[Note] = []

    prior = mp.fit_prior(log, "quick", progress=Progress(notes.append))

    constants = prior.constants()
    for name in ("kp", "armature", "coulomb", "torque_limit", "viscous_damping"):
        assert not constants[name].identifiable, name
    (note,) = [note.text for note in notes if "scale of torques" in note.text]
    assert "torque_feedforward" in note
