"""Names of the measured quantities, and their order in every table."""

from __future__ import annotations

BENCH_METRICS = {
    "bench_sine_rmse": "sine",
    "bench_gait_rmse": "gait",
    "bench_steps_rmse": "steps",
    "bench_impact_rmse": "impacts",
    "bench_chirp_rmse": "chirp",
}
ROBOT_METRICS = ("standing_rmse", "suspended_rmse", "standing_torque_hf", "suspended_torque_hf")
# joint RMSE [rad] and torque above 20 Hz [N·m], over motors and trials; robots without legs have only the bench's
FIDELITY_METRICS = (*BENCH_METRICS, *ROBOT_METRICS)
DIVERGED = 1e3  # torque [N·m] and displacement [m] of a model whose simulation diverges; its angle error is MAX_ERROR
MODELS = (  # actuator models
    "ideal_pd", "tuned_pd", "actuator_net", "paper", "paper_wide", "one_network", "latent_network",
    "per_motor", "rollout", "physical",
)  # fmt: skip
TRAINING_CONDITIONS = ("ideal_pd", "tuned_pd", "paper", "rollout", "oracle")  # actuator models of trainings
