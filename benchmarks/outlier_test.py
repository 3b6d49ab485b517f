"""Power of the outlier test of `motorprior adapt` at its nominal false-alarm rate.

    python benchmarks/outlier_test.py runs/prior_mixed/prior.safetensors

Motors of the fleet, unchanged and with one constant changed, are adapted to a log each. The table
has the fraction with a p-value below FALSE_ALARMS, and the median closed-loop error of the
posterior means on held-out gait + impacts.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tyro

from figures import markdown
from motorprior.bench.bench_folder import bench_from_json
from motorprior.bench.recording import bench_schedule, record
from motorprior.priors.adapt import FALSE_ALARMS, adapt_to, outlier_test
from motorprior.priors.prior_file import load_prior
from motorprior.robots.load import load_robot
from motorprior.robots.shipped import DEFAULT_ROBOT
from virtual_fleets.held_out_trials import HELD_OUT_SEED, bench_errors

CHANGES: dict[str, dict[str, float]] = {
    "none": {},
    "kp and kd x 2.5": {"kp": 2.5, "kd": 2.5},
    "kd / 4": {"kd": 0.25},
    "delay x 3": {"delay": 3.0},
    "armature x 4": {"armature": 4.0},
    "coulomb x 4": {"coulomb": 4.0},
    "backlash x 5": {"backlash": 5.0},
    "torque_limit / 2": {"torque_limit": 0.5},
}
STREAM = 57


@dataclass(frozen=True)
class Settings:
    """Settings of the benchmark."""

    prior: tyro.conf.Positional[Path]  # prior of preset rollout, identified from a bench
    motors: int = 16  # motors per change
    seconds: float = 10.0  # log to which each motor is adapted [s]
    changes: tuple[str, ...] = tuple(CHANGES)  # changed constants


def measure(settings: Settings) -> str:
    """Markdown: a row per changed constant."""
    prior = load_prior(settings.prior, load_robot(DEFAULT_ROBOT))
    bench = bench_from_json(prior.provenance.get("bench"), str(settings.prior))
    rng = np.random.default_rng([HELD_OUT_SEED, bench.seed, STREAM])
    unchanged = bench.fleet.sample(settings.motors, rng)
    schedule = bench_schedule("adapt")
    steps = round(settings.seconds / schedule.period)

    rows = []
    for name in settings.changes:
        motors = unchanged.scaled(CHANGES[name])
        log = record(motors, schedule, steps, HELD_OUT_SEED + bench.seed, bench.fleet)
        posterior = adapt_to(prior, log)
        p_values, _ = outlier_test(prior, log, posterior)
        detected = np.mean(p_values < FALSE_ALARMS)

        model = {"model": lambda index, z=posterior.mean: prior.model.motors(z[index])}
        error = bench_errors(motors, model, bench.seed)["impacts"]["model"]
        rows.append([name, f"{detected:.2f}", f"{1e3 * np.median(error):.1f}"])
    return markdown(["changed constant", "detected", "error [mrad]"], rows)


if __name__ == "__main__":
    print(measure(tyro.cli(Settings, description=__doc__)))
