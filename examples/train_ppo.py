"""Train PPO of Stable-Baselines3 on motors sampled from a prior, on a CPU: pip install 'motorprior[rl]'.

python examples/train_ppo.py runs/prior/prior.safetensors 300000
"""

import sys

import gymnasium
import numpy as np
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize

import motorprior.environments

PRIOR, STEPS = sys.argv[1], int(sys.argv[2])


def make() -> gymnasium.Env:
    """Twelve other motors in every episode of 5 s."""
    return gymnasium.make(motorprior.environments.ENV_ID, actuator="prior", prior=PRIOR, episode_steps=500)


torch.set_num_threads(1)
envs = VecNormalize(DummyVecEnv([make] * 8))
model = PPO("MlpPolicy", envs, n_steps=512, batch_size=512, gamma=0.98, policy_kwargs={"log_std_init": -1.5}, seed=0)
print("seconds walked:", STEPS * 0.01)
model.learn(STEPS)

envs.training, walked, steps = False, [], []
for seed in range(10):
    env = make()
    (observation, _), over, count = env.reset(seed=seed), False, 0
    while not over:
        action, _ = model.predict(envs.normalize_obs(observation), deterministic=True)
        observation, _, terminated, truncated, info = env.step(action)
        over, count = terminated or truncated, count + 1
    walked.append(info["base_pos"][0])
    steps.append(count)
print(f"on 10 new sets of motors: {np.mean(walked) / 5:.2f} m/s, up for {np.mean(steps) / 100:.1f} of 5 s")
