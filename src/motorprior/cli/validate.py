"""The command validate: fidelity on training and held-out motors is printed."""

from motorprior.cli.terminal import print_table
from motorprior.commands.validate import Validate, run_validate
from motorprior.progress import Progress
from motorprior.report.tables import fidelity_table
from motorprior.studies.robot_fidelity import FIDELITY_METRICS

_TITLES = {
    "train": "Closed-loop joint RMSE [rad] and torque above 20 Hz (hf) [N·m], medians; "
    "physical: the true motors, started 4 mrad off",
    "held_out": "The same on held-out motors, adapted to 10 s of log each",
}
_DISTRIBUTION = (
    "adapt_rmse_ratio",
    "adapt_false_alarms",
    "coverage50",
    "coverage90",
    "two_sample_auc",
)


def run(config: Validate, progress: Progress) -> None:
    """Validate and print tables; priors without physics have no table of the distribution."""
    results = run_validate(config, progress)
    for motors, title in _TITLES.items():
        print_table(title, *fidelity_table(results, FIDELITY_METRICS, motors))
    figures = results.where(quantity=_DISTRIBUTION).to_figures()
    if figures:
        rows = [[name, f"{value:.3f}"] for name, value in figures.items()]
        print_table("Preset rollout on held-out motors", ["figure", "value"], rows)
