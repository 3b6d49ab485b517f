"""From motor logs to a motor prior.

python examples/log_to_prior.py                                  # without logs: a virtual bench of Pupper motors
python examples/log_to_prior.py run.csv --columns columns.toml --robot arm.toml --suspended --out
runs/my_prior
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

robot = mp.load_robot(args.robot)
logs = [
    mp.load_log(
        path,
        columns=args.columns,
        robot=robot,
        suspended=args.suspended,
        settings=mp.LogSettings(period=args.period),
    )
    for path in args.logs
]
if not logs:
    logs = [mp.record_bench(robot, motors=args.motors, steps=args.samples, preset=args.preset)]
for log in logs:
    for finding in mp.check_log(log).findings:
        print(f"{log.source}: {finding.severity}: {finding.message}")
prior = mp.fit_prior(
    logs, args.preset, steps=args.steps, out=args.out, progress=mp.Lines(sys.stderr)
)
print(
    f"{len(prior.mean)} motors, latents {prior.model.num_latents}, loss {prior.metrics['final_loss']:.4f}"
)

rest = np.zeros(5)
motors = mp.Motors(prior.sample(5, seed=0), dt=0.002, joint_pos=rest)
for _ in range(20):  # 40 ms with fixed joints, longer than any delay
    torque, damping = motors.step(rest + 0.1, rest, rest)
print(
    "five new motors with a position error of 0.1 rad:",
    np.round(torque, 3),
    "N·m; damping",
    np.round(damping, 3),
)
