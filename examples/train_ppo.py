"""PPO on sampled motors (motorprior[rl]): python examples/train_ppo.py runs/prior/prior.safetensors 300000."""

import sys

import gymnasium
import numpy as np
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.vec_env import VecNormalize

from motorprior.environments import ENV_ID
from motorprior.locomotion.command import Commands
from motorprior.simulation.randomization import ROBUST

if len(sys.argv) != 3:
    sys.exit("usage: python examples/train_ppo.py PRIOR STEPS")
torch.set_num_threads(1)
# As `motorprior walk`, but 5 s per episode: each has new motors, floor, load and pushes.
robot = {"motors": f"prior:{sys.argv[1]}", "episode_steps": 500, "randomization": ROBUST}
envs = VecNormalize(make_vec_env(ENV_ID, n_envs=8, seed=0, env_kwargs=robot))
model = PPO(
    "MlpPolicy",
    envs,
    n_steps=512,
    batch_size=512,
    gamma=0.98,
    policy_kwargs={"log_std_init": -1.5},
    seed=0,
)
model.learn(int(sys.argv[2]))
walked = []
for seed in range(10_000, 10_010):
    env = gymnasium.make(ENV_ID, **robot, commands=Commands.steady(0.3))
    over = False
    steps = 0
    observation, info = env.reset(seed=seed)
    while not over:
        action, _ = model.predict(envs.normalize_obs(observation), deterministic=True)
        observation, _, terminated, truncated, info = env.step(action)
        over = terminated or truncated
        steps = steps + 1
    walked.append((info["base_pos"][0] / 5, steps / 100))
print(
    "commanded 0.3 m/s on 10 new sets of motors: {:.2f} m/s, upright for {:.1f} of 5 s".format(
        *np.mean(walked, axis=0)
    )
)
