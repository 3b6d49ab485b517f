"""From a recording of an SO-101 to motors in MuJoCo.

Record, on the arm or on a virtual one, then run this example:

    motorprior record --port /dev/ttyACM0 --robot so101 --out runs/arm
    motorprior record --virtual --robot so101 --yes --out runs/arm

    python examples/so101.py runs/arm/run.servolog
"""

import argparse
import sys
from pathlib import Path

import mujoco
import numpy as np

import motorprior as mp

parser = argparse.ArgumentParser(
    description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
)
parser.add_argument("recording", help="run.servolog of `motorprior record --robot so101`")
parser.add_argument("--preset", default="quick", help="recipe of the fit; long_runs is better")
parser.add_argument("--steps", type=int, help="for presets that train a network")
parser.add_argument("--out", type=Path, default=Path("runs/example_so101"))
args = parser.parse_args()

# the recording states gains, registers, units and posture; the robot's model gives the loads
robot = mp.load_robot("so101")
log = mp.load_log(args.recording, robot=robot)
for finding in mp.check_log(log).findings:
    print(f"{finding.severity}: {finding.message}")

# the motors of this arm, with intervals of their constants
progress = mp.Lines(sys.stderr)
prior = mp.fit_prior(log, args.preset, steps=args.steps, out=args.out, progress=progress)
for joint in log.joint_names:
    print(joint)
    print(prior.constants(joint))

# MJCF of the arm with a sample of its motors, in a simulation of a step of all joints
exported = mp.export(
    prior, "mjcf", args.out / "mjcf", model=robot.model.path, joints=log.joint_names, log=log
)
(path,) = [file for file in exported.files if file.suffix == ".xml"]
model = mujoco.MjModel.from_xml_path(str(path))
data = mujoco.MjData(model)

# the MJCF lacks the profile of the servos' firmware, unless `record --profile off` switched it off
profile = None
if log.firmware.get("profile_acceleration"):
    limits = path.with_name("motors.json")
    profile = mp.MotionProfile.load(limits, dt=model.opt.timestep, start=data.qpos)
target = robot.nominal_pose
while data.time < 1.0:
    data.ctrl[:] = target if profile is None else profile.step(target)
    mujoco.mj_step(model, data)
print(f"{path}: {np.round(data.qpos - robot.nominal_pose, 3)} rad from a target after 1 s")
