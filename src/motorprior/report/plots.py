"""Every plot of the report, by one name: pure functions from arrays to a matplotlib `Figure`."""

from motorprior.report.plots_latent import latent_map
from motorprior.report.plots_motor import closed_loop, excitation_and_response, torque_fit
from motorprior.report.plots_robot import real_replay, robot_traces
from motorprior.report.plots_study import fidelity_bars, learning_curves, transfer_bars
from motorprior.report.plots_style import MODEL_COLORS, MODEL_LABELS, model_color, model_label

__all__ = [
    "MODEL_COLORS",
    "MODEL_LABELS",
    "closed_loop",
    "excitation_and_response",
    "fidelity_bars",
    "latent_map",
    "learning_curves",
    "model_color",
    "model_label",
    "real_replay",
    "robot_traces",
    "torque_fit",
    "transfer_bars",
]
