"""Power of the outlier test of `motorprior adapt` at its nominal false-alarm rate.

    python benchmarks/outlier_test.py runs/prior_mixed/prior.safetensors

MOTORS motors of the fleet, unchanged and with one constant changed, each adapted to SECONDS of log:
the fraction with a p-value below FALSE_ALARMS, and the median closed-loop error of the posterior
means on held-out gait + impacts.
"""

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
SECONDS = 10.0
MOTORS = 16
STREAM = 57


def measure(prior: tyro.conf.Positional[Path]) -> None:
    """Print the table for a prior of preset rollout that was identified from a bench."""
    loaded = load_prior(prior, load_robot(DEFAULT_ROBOT))
    bench = bench_from_json(loaded.provenance.get("bench"), str(prior))
    rng = np.random.default_rng([HELD_OUT_SEED, bench.seed, STREAM])
    unchanged = bench.fleet.sample(MOTORS, rng)
    preset = bench_schedule("adapt")
    steps = round(SECONDS / preset.period)

    rows = []
    for name, change in CHANGES.items():
        motors = unchanged.scaled(change)
        log = record(motors, preset, steps, HELD_OUT_SEED + bench.seed, bench.fleet)
        posterior = adapt_to(loaded, log)
        p_values, _ = outlier_test(loaded, log, posterior)
        detected = np.mean(p_values < FALSE_ALARMS)

        model = {"model": lambda index, z=posterior.mean: loaded.model.motors(z[index])}
        error = bench_errors(motors, model, bench.seed)["impacts"]["model"]
        rows.append([name, f"{detected:.2f}", f"{1e3 * np.median(error):.1f}"])
    print(markdown(["changed constant", "detected", "error [mrad]"], rows))


if __name__ == "__main__":
    tyro.cli(measure, description=__doc__)
