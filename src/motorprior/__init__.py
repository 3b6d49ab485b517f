"""Learn the distribution of a robot's motors from logs, and train policies on samples of it.

    import motorprior as mp
    log = mp.record_bench()    # or a recording: mp.load_log("log.csv", columns="columns.toml")
    prior = mp.fit_prior(log)
    motors = mp.Motors(prior.sample(12, seed=0), dt=0.002, joint_pos=start)
    torque, damping = motors.step(position_target, joint_pos, joint_vel)

Each name is imported at its first use, so numba, MuJoCo, JAX and Gymnasium load only when they are
needed.
"""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from motorprior.actuator.fleet import Fleet as Fleet
    from motorprior.actuator.fleet import generic_fleet as generic_fleet
    from motorprior.actuator.fleet import load_fleet as load_fleet
    from motorprior.actuator.ideal_pd import IdealPd as IdealPd
    from motorprior.actuator.motor_posterior import MotorPosterior as MotorPosterior
    from motorprior.actuator.motor_prior import MotorPrior as MotorPrior
    from motorprior.actuator.motors import Motors as Motors
    from motorprior.actuator.physical import PhysicalActuator as PhysicalActuator
    from motorprior.bench.bench_folder import record_bench as record_bench
    from motorprior.environments import make_env as make_env
    from motorprior.exceptions import ArtifactError as ArtifactError
    from motorprior.exceptions import ConfigError as ConfigError
    from motorprior.exceptions import LogError as LogError
    from motorprior.exceptions import MotorPriorError as MotorPriorError
    from motorprior.exceptions import SimulationFault as SimulationFault
    from motorprior.excitation.fit_excitation import fit_excitation as fit_excitation
    from motorprior.exports.bam import read_motor as read_motor
    from motorprior.exports.cards import from_pretrained as from_pretrained
    from motorprior.exports.motion_profile import MotionProfile as MotionProfile
    from motorprior.exports.registry import export as export
    from motorprior.identification.load_fit import with_fitted_loads as with_fitted_loads
    from motorprior.locomotion.policy import Policy as Policy
    from motorprior.logs.doctor.checks import check_log as check_log
    from motorprior.logs.load_log import load_log as load_log
    from motorprior.logs.motor_log import MotorLog as MotorLog
    from motorprior.logs.prepare_log import LogSettings as LogSettings
    from motorprior.logs.read_log import read_log as read_log
    from motorprior.logs.readers.motor_log_file import write_log as write_log
    from motorprior.priors.adapt import adapt as adapt
    from motorprior.priors.fit_prior import fit_prior as fit_prior
    from motorprior.priors.validate import validate as validate
    from motorprior.progress import Lines as Lines
    from motorprior.report.plots import plot_steps as plot_steps
    from motorprior.robots.load import load_robot as load_robot
    from motorprior.robots.robot import Robot as Robot
    from motorprior.simulation.driven_joints import DrivenJoints as DrivenJoints
    from motorprior.simulation.playback import simulate as simulate
    from motorprior.simulation.training import train_policy as train_policy
    from motorprior.studies.compare import compare as compare

__version__ = "0.1.0"

# public name -> its module; the same as in the imports above, which only type checkers run
_MODULES = {
    "IdealPd": "motorprior.actuator.ideal_pd",
    "MotorPosterior": "motorprior.actuator.motor_posterior",
    "MotorPrior": "motorprior.actuator.motor_prior",
    "Motors": "motorprior.actuator.motors",
    "PhysicalActuator": "motorprior.actuator.physical",
    "record_bench": "motorprior.bench.bench_folder",
    "Fleet": "motorprior.actuator.fleet",
    "generic_fleet": "motorprior.actuator.fleet",
    "load_fleet": "motorprior.actuator.fleet",
    "make_env": "motorprior.environments",
    "ArtifactError": "motorprior.exceptions",
    "ConfigError": "motorprior.exceptions",
    "LogError": "motorprior.exceptions",
    "MotorPriorError": "motorprior.exceptions",
    "SimulationFault": "motorprior.exceptions",
    "fit_excitation": "motorprior.excitation.fit_excitation",
    "read_motor": "motorprior.exports.bam",
    "from_pretrained": "motorprior.exports.cards",
    "MotionProfile": "motorprior.exports.motion_profile",
    "export": "motorprior.exports.registry",
    "with_fitted_loads": "motorprior.identification.load_fit",
    "Policy": "motorprior.locomotion.policy",
    "check_log": "motorprior.logs.doctor.checks",
    "load_log": "motorprior.logs.load_log",
    "MotorLog": "motorprior.logs.motor_log",
    "LogSettings": "motorprior.logs.prepare_log",
    "read_log": "motorprior.logs.read_log",
    "write_log": "motorprior.logs.readers.motor_log_file",
    "adapt": "motorprior.priors.adapt",
    "fit_prior": "motorprior.priors.fit_prior",
    "validate": "motorprior.priors.validate",
    "Lines": "motorprior.progress",
    "plot_steps": "motorprior.report.plots",
    "load_robot": "motorprior.robots.load",
    "Robot": "motorprior.robots.robot",
    "DrivenJoints": "motorprior.simulation.driven_joints",
    "simulate": "motorprior.simulation.playback",
    "train_policy": "motorprior.simulation.training",
    "compare": "motorprior.studies.compare",
}
__all__ = ["__version__", *_MODULES]  # pyright: ignore[reportUnsupportedDunderAll]

if not TYPE_CHECKING:  # otherwise a type checker would accept every name

    def __getattr__(name: str) -> object:
        """The public name, imported at its first use."""
        if name not in _MODULES:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        globals()[name] = getattr(import_module(_MODULES[name]), name)
        return globals()[name]


def __dir__() -> list[str]:
    return sorted(__all__)
