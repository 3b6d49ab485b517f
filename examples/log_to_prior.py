"""From motor logs to a motor prior.

Without logs, the motors are those of a virtual bench:

    python examples/log_to_prior.py
    python examples/log_to_prior.py run.csv --columns columns.toml --robot arm.toml --suspended
"""

import argparse
import sys

import numpy as np

import motorprior as mp

parser = argparse.ArgumentParser(
    description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
)
parser.add_argument("logs", nargs="*", help="any logs that mp.load_log reads")
parser.add_argument("--columns", help="column map of tables, a .toml file")
parser.add_argument(
    "--period", type=float, default=0.002, help="time step of the logs [s], that of the preset"
)
parser.add_argument(
    "--suspended", action="store_true", help="the robot was suspended: its model gives the loads"
)
parser.add_argument("--robot", default="pupper_v2", help="a shipped robot, or a .toml file")
parser.add_argument("--motors", type=int, default=32, help="motors of the virtual bench")
parser.add_argument(
    "--samples", type=int, default=10_000, help="samples per motor of the virtual bench"
)
parser.add_argument(
    "--preset", default="rollout", help="rollout, or paper for a quick run on logs with torques"
)
parser.add_argument("--steps", type=int, help="Adam steps; those of the preset if not given")
parser.add_argument(
    "--out", default="runs/example_prior", help="folder of the prior; a rerun resumes there"
)
args = parser.parse_args()

# the logs
robot = mp.load_robot(args.robot)
logs = []
for path in args.logs:
    log = mp.load_log(
        path,
        columns=args.columns,
        robot=robot,
        suspended=args.suspended,
        settings=mp.LogSettings(period=args.period),
    )
    logs.append(log)
if not logs:
    logs = [mp.record_bench(robot, motors=args.motors, steps=args.samples, preset=args.preset)]
for log in logs:
    for finding in mp.check_log(log).findings:
        print(f"{log.source}: {finding.severity}: {finding.message}")

# the prior
progress = mp.Lines(sys.stderr)
prior = mp.fit_prior(logs, args.preset, steps=args.steps, out=args.out, progress=progress)
loss = prior.metrics.final_loss
print(f"{len(prior.mean)} motors, latents {prior.model.num_latents}, loss {loss:.4f}")

# five new motors, with a position error of 0.1 rad on fixed joints for 40 ms, longer than any delay
rest = np.zeros(5)
motors = mp.Motors(prior.sample(5, seed=0), dt=0.002, joint_pos=rest)
for _ in range(20):
    torque, damping = motors.step(rest + 0.1, rest, rest)
print(
    f"five new motors: torques {np.round(torque, 3)} N·m, dampings {np.round(damping, 3)} N·m·s/rad"
)
