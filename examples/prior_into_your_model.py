"""Motors of a prior on the joints of any MuJoCo model, here an arm.

python examples/prior_into_your_model.py runs/example_prior/prior.safetensors
"""

import argparse

import mujoco
import numpy as np

import motorprior as mp

ARM = """
<mujoco>
  <option timestep="0.002" integrator="implicitfast"/>
  <worldbody>
    <body name="upper_arm">
      <joint name="shoulder" axis="0 1 0"/>
      <geom type="capsule" fromto="0 0 0 0 0 -0.12" size="0.01" mass="0.06"/>
      <body name="forearm" pos="0 0 -0.12">
        <joint name="elbow" axis="0 1 0"/>
        <geom type="capsule" fromto="0 0 0 0 0 -0.1" size="0.01" mass="0.04"/>
      </body>
    </body>
  </worldbody>
</mujoco>"""

parser = argparse.ArgumentParser(
    description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
)
parser.add_argument("prior", help="prior.safetensors, for example from examples/log_to_prior.py")
parser.add_argument("--arms", type=int, default=5, help="number of arms, each with new motors")
parser.add_argument("--seconds", type=float, default=2.0)
args = parser.parse_args()

prior = mp.MotorPrior.load(args.prior)
for seed in range(args.arms):
    # the motors replace armature, damping and friction of its joints
    model = mujoco.MjModel.from_xml_string(ARM)
    data = mujoco.MjData(model)
    driven = mp.DrivenJoints(model, data, prior.sample(2, seed), ["shoulder", "elbow"])

    errors = []
    for _ in range(round(args.seconds / model.opt.timestep)):
        target = 0.5 * np.sin(2 * np.pi * data.time + np.array([0.0, np.pi / 2]))
        driven.drive(target)  # torque and damping of this step
        mujoco.mj_step(model, data)
        errors.append(target - data.qpos)

    shoulder, elbow = 1e3 * np.sqrt(np.mean(np.square(errors), axis=0))
    print(f"motors {seed}: tracking error shoulder {shoulder:.0f} mrad, elbow {elbow:.0f} mrad")
