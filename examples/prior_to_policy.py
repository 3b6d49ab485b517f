"""From a motor prior to a walking policy, compared with one trained on ideal motors.

python examples/prior_to_policy.py runs/example_prior/prior.safetensors
"""

import argparse
import sys

import motorprior as mp

parser = argparse.ArgumentParser(
    description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
)
parser.add_argument("prior")
parser.add_argument("--robot", default="pupper_v2", help="a shipped legged robot, or a .toml file")
parser.add_argument(
    "--fleet", help="physical motors of the twin; the default fleet of the robot if not given"
)
parser.add_argument("--iterations", type=int, default=200)
parser.add_argument("--episode-steps", type=int, default=1000, help="steps of 10 ms")
parser.add_argument("--seed", type=int, default=0)
parser.add_argument("--out", default="runs/example_policy.safetensors")
args = parser.parse_args()

robot = mp.load_robot(args.robot)
progress = mp.Lines(sys.stderr)
prior = mp.MotorPrior.load(args.prior)
fleet = mp.load_fleet(args.fleet or robot.default_fleet)

# the ideal motors have the gains and the torque limit of the fleet's central motor
nominal = fleet.center(1)
ideal = mp.IdealPd.uniform(robot.num_joints, nominal.kp[0], nominal.kd[0], nominal.torque_limit[0])

policies = {}
for name, motors in (("prior", prior), ("ideal PD", ideal)):
    policies[name] = mp.train_policy(
        robot,
        motors,
        iterations=args.iterations,
        episode_steps=args.episode_steps,
        seed=args.seed,
        progress=progress,
    )
policies["prior"].save(args.out)

for row in mp.compare(robot, policies, {"twin": fleet, "prior": prior}, progress=progress):
    print(f"trained on {row.model:8} on {row.motors:5}: {row.quantity} {row.value:.2f} {row.unit}")
