"""Settings of the motion in a recording of a real robot."""

from dataclasses import dataclass


@dataclass(frozen=True)
class MotionSettings:
    """Settings of the motion in a recording."""

    excitation: str | None = None
    """Name of a signal, or a file of `motorprior excite`; not of servos, which have a motion of
    their own. The signals sine, chirp, steps, multisine, gait and creep excite every joint on its
    own; trot is a gait of the whole robot; varied is a multisine on all joints, then steps on one
    joint after the other. If not given: varied in the air, multisine for a standing robot."""
    joint: str = "all"
    """Joints to excite: all, a whole leg (FR), a joint of every leg (knee) or one joint (FR_knee).
    Of servos always all."""
    seconds: float = 60.0
    """Duration [s]; of servos without the slow ways from one pose to the next."""
    amplitude: float | None = None
    """Maximum distance of the targets from the nominal pose [rad], of servos from the pose in which
    a joint moves. If not given: 0.4 in the air, 0.1 for a standing robot, 0.5 for servos."""
    max_speed: float | None = None
    """Limit of the targets' speed [rad/s]. If not given: 12 for servos; 40, as in a walk, for
    the signals steps and varied in the air; 8 otherwise."""
    standing: bool = False
    """The robot stands on the ground and sits down afterwards; otherwise it is suspended in the
    air."""
    seed: int = 0
    """Seed of the random signals."""
