"""PPO on sampled motors (motorprior[rl]): python examples/train_ppo.py runs/prior/prior.safetensors 300000."""

import sys

import gymnasium
import numpy as np
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.vec_env import VecNormalize

from motorprior.environments import ENV_ID

torch.set_num_threads(1)
robot = {"actuator": "prior", "prior": sys.argv[1], "episode_steps": 500}  # 5 s, twelve other motors in every episode
envs = VecNormalize(make_vec_env(ENV_ID, n_envs=8, seed=0, env_kwargs=robot))
model = PPO("MlpPolicy", envs, n_steps=512, batch_size=512, gamma=0.98, policy_kwargs={"log_std_init": -1.5}, seed=0)
model.learn(int(sys.argv[2]))

metres, seconds = [], []
for seed in range(10_000, 10_010):
    env, over, steps = gymnasium.make(ENV_ID, **robot), False, 0
    observation, info = env.reset(seed=seed)
    while not over:
        action, _ = model.predict(envs.normalize_obs(observation), deterministic=True)
        observation, _, terminated, truncated, info = env.step(action)
        over, steps = terminated or truncated, steps + 1
    metres.append(info["base_pos"][0])
    seconds.append(steps / 100)
print(f"on 10 new sets of motors: {np.mean(metres) / 5:.2f} m/s, up for {np.mean(seconds):.1f} of 5 s")
