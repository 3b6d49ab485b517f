"""Targets of a policy on an SO-101 by LeRobot, with the motion profile of its simulation.

`examples/so101.py` writes motors.json. The servos' own profile is switched off, and the profile of
the simulation is applied to the targets, so that both follow the same command:

    pip install "lerobot[feetech]"
    python examples/so101_lerobot.py --port /dev/ttyACM0 --id my_arm
"""

import argparse
import time
from pathlib import Path

import numpy as np
from lerobot.robots.so_follower import SO101Follower, SO101FollowerConfig

import motorprior as mp

parser = argparse.ArgumentParser(
    description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
)
parser.add_argument("--port", required=True)
parser.add_argument("--id", default="my_arm", help="of the arm's calibration in LeRobot")
parser.add_argument("--motors", type=Path, default=Path("runs/example_so101/mjcf/motors.json"))
parser.add_argument("--rate", type=float, default=50.0, help="of actions [Hz]")
parser.add_argument("--seconds", type=float, default=5.0)
args = parser.parse_args()

arm = SO101Follower(SO101FollowerConfig(port=args.port, id=args.id, use_degrees=True))
arm.connect()
try:
    # LeRobot has written 254, 39 rad/s², into all registers
    for joint in arm.bus.motors:
        arm.bus.write("Acceleration", joint, 0)

    # angles are in degrees; the gripper, in per cent of its range, gets no target here
    observation = arm.get_observation()
    joints = [joint for joint in arm.bus.motors if joint != "gripper"]
    start = np.radians([observation[f"{joint}.pos"] for joint in joints])
    profile = mp.MotionProfile.load(args.motors, dt=1.0 / args.rate, start=np.append(start, 0.0))

    begin = time.perf_counter()
    target = start
    for step in range(round(args.seconds * args.rate)):
        # the targets of your policy [rad]; here a step of 0.1 rad after a second
        target = start + (0.1 if step >= args.rate else 0.0)
        reference = profile.step(np.append(target, 0.0))[:-1]
        action = dict(zip(joints, np.degrees(reference).tolist(), strict=True))
        arm.send_action({f"{joint}.pos": value for joint, value in action.items()})
        time.sleep(max(0.0, begin + (step + 1) / args.rate - time.perf_counter()))

    observation = arm.get_observation()
    end = np.radians([observation[f"{joint}.pos"] for joint in joints])
    print(f"{np.round(end - target, 3)} rad from the target")
finally:
    arm.disconnect()
