"""Check that motors carry a robot that stands at its nominal pose."""

import numpy as np

from motorprior.simulation.scene import Scene

SECONDS = 1.0  # time for which the robot stands [s]
MIN_HEIGHT = 0.5  # height of the base after that time over its initial height [-]


def standing_warning(scene: Scene, seed: int) -> str:
    """The warning if the robot sinks at its nominal pose; otherwise "".

    The position targets are the nominal pose. ``seed`` draws the motors and the domain, as for an
    episode. A robot with a simulation fault gets no warning: the training counts its faults.
    """
    robot = scene.robot
    motors, domain = scene.sample(seed)
    world = scene.world()
    simulation = world.reset(motors, domain=domain)
    state = simulation.state()
    initial_height = float(state.base_pos[2])

    target = np.ascontiguousarray(robot.nominal_pose)
    for _ in range(round(SECONDS / robot.control_dt)):
        state = simulation.step(target)
        if state.fault != 0:
            break
    world.close()

    height = float(state.base_pos[2])
    if state.fault != 0 or height >= MIN_HEIGHT * initial_height:
        return ""
    sinking = f"the base sinks from {initial_height:.2f} to {max(height, 0.0):.2f} m"
    return (
        f"{robot.name} does not stand on these motors: in {SECONDS:g} s at its nominal pose "
        f"{sinking}, so a policy cannot walk -> check the gains, gear ratios and torque limits of "
        "the motors, and the masses of the model"
    )
