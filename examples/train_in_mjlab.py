"""Train mjlab's velocity task with sampled motors.

    python examples/train_in_mjlab.py --card go2 --worlds 4096

mjlab 1.6 has the Go1, not the Go2; its robot gets motors of the Go2's card here. Needs the extra
mjlab, and a GPU for more than a few worlds.
"""

import argparse
from dataclasses import asdict

import numpy as np
import torch
from mjlab.envs import ManagerBasedRlEnv
from mjlab.rl import MjlabOnPolicyRunner, RslRlVecEnvWrapper
from mjlab.tasks.velocity.config.go1.env_cfgs import unitree_go1_flat_env_cfg
from mjlab.tasks.velocity.config.go1.rl_cfg import unitree_go1_ppo_runner_cfg

import motorprior as mp
from motorprior.exports.mjlab import MotorPriorActuatorCfg, per_world_damping
from motorprior.exports.warp_motors import max_steps

parser = argparse.ArgumentParser(
    description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
)
parser.add_argument("--card", default="go2", help="motor card: a shipped one, or your folder")
parser.add_argument("--worlds", type=int, default=4096)
parser.add_argument("--iterations", type=int, default=500)
parser.add_argument("--pd", action="store_true", help="the task's own PD, to compare")
args = parser.parse_args()

device = "cuda:0" if torch.cuda.is_available() else "cpu"
cfg = unitree_go1_flat_env_cfg()
cfg.scene.num_envs = args.worlds
if not args.pd:
    prior = mp.from_pretrained(args.card)
    kp = 30.0  # of the policy's position servo [N·m/rad]
    kd = 0.8  # [N·m·s/rad]
    motors = MotorPriorActuatorCfg(
        target_names_expr=(".*_joint",),
        source=prior,
        gains=((kp,) * 12, (kd,) * 12),
        samples=256,
    )
    cfg.scene.entities["robot"].articulation.actuators = (motors,)
    cfg.events["motors"] = per_world_damping()

    # a step that resolves the gears of all samples, at the same control rate
    gains_of_samples = np.tile([[kp], [kd]], 3072)
    classes = np.resize(prior.classes.of_motors, 3072).tolist()
    samples = prior.sample(classes, seed=0, gains=gains_of_samples)
    control_dt = cfg.sim.mujoco.timestep * cfg.decimation
    needed = int(np.ceil(control_dt / float(max_steps(samples).min())))
    cfg.decimation = max(cfg.decimation, needed)
    cfg.sim.mujoco.timestep = control_dt / cfg.decimation

env = ManagerBasedRlEnv(cfg=cfg, device=device)
agent = unitree_go1_ppo_runner_cfg()
agent.logger = "tensorboard"
runner = MjlabOnPolicyRunner(RslRlVecEnvWrapper(env), asdict(agent), "runs/mjlab", device)
runner.learn(args.iterations)
