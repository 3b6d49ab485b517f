"""PPO on sampled motors; needs the extra `rl`.

python examples/train_ppo.py runs/prior/prior.safetensors 300000
"""

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
_, prior, steps = sys.argv
torch.set_num_threads(1)

# as `motorprior walk`, but 5 s per episode: each has new motors, floor, load and pushes
robot = {"motors": f"prior:{prior}", "episode_steps": 500, "randomization": ROBUST}
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
model.learn(int(steps))

speeds = []  # [m/s]
times_upright = []  # [s]
for seed in range(10_000, 10_010):
    env = gymnasium.make(ENV_ID, **robot, commands=Commands.steady(0.3))
    observation, info = env.reset(seed=seed)
    num_steps = 0
    is_over = False
    while not is_over:
        action, _ = model.predict(envs.normalize_obs(observation), deterministic=True)
        observation, _, terminated, truncated, info = env.step(action)
        is_over = terminated or truncated
        num_steps += 1
    speeds.append(info["base_pos"][0] / 5)
    times_upright.append(num_steps / 100)
print(
    f"commanded 0.3 m/s on 10 new sets of motors: {np.mean(speeds):.2f} m/s, "
    f"upright for {np.mean(times_upright):.1f} of 5 s"
)
