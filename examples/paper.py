"""The paper in one file: a latent actuator learned from many motors, and gaits trained on samples.

1 motors with friction, delay and backlash on a bench, commanded by sinusoids
2 torque = f(history of error and velocity, z), a Gaussian over z per motor: MSE + weight·KL
3 a Pupper in MuJoCo on these motors, z ~ N(0, I) for every motor and episode; an ideal PD is
  the baseline
4 a trajectory generator that a linear policy modulates, trained by augmented random search
5 both policies on held-out physical motors

python examples/paper.py        # about two minutes
"""

import argparse
import sys

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import optax

import motorprior as mp
from motorprior.actuator.latent import LatentNetwork
from motorprior.robots.build_model import build_model

parser = argparse.ArgumentParser(
    description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
)
parser.add_argument("--motors", type=int, default=32, help="motors of the bench")
parser.add_argument("--samples", type=int, default=10_000, help="samples of each, every 0.01 s")
parser.add_argument("--steps", type=int, default=3000, help="Adam steps")
parser.add_argument("--iterations", type=int, default=12, help="of the random search")
parser.add_argument(
    "--directions", type=int, default=8, help="of the random search, two episodes each"
)
parser.add_argument("--seconds", type=float, default=3.0, help="of an episode")
args = parser.parse_args()
robot = mp.load_robot("pupper_v2")
fleet = mp.load_fleet("pupper_v2")

# 1 Logs: error and velocity of the last TAPS samples are the input, the torque is the output.
TAPS = 5
PERIOD = 0.01
LATENTS = 4
NEURONS = 24
KL_WEIGHT = 1e-3
BATCH = 1024
log = mp.record_bench(robot, motors=args.motors, steps=args.samples, preset="paper")
error = log.position_target - log.joint_pos
velocity = log.joint_vel
torque = log.joint_torque
error_scale = np.std(error)
velocity_scale = np.std(velocity)
torque_scale = np.std(torque)
past = [slice(TAPS - 1 - age, len(error) - age) for age in range(TAPS)]
errors = [error[rows] / error_scale for rows in past]
velocities = [velocity[rows] / velocity_scale for rows in past]
inputs = np.stack(errors + velocities, axis=-1)
outputs = torque[TAPS - 1 :] / torque_scale


# 2 The latent actuator. Motor i has z = mean_i + std_i·noise, noise ~ N(0, I), so z ~ N(0, I) is
# another motor.
def f(net, x, z):
    """Torque / torque_scale."""
    hidden = jax.nn.soft_sign(x @ net["w1"] + z @ net["v1"] + net["b1"])
    return jax.nn.soft_sign(hidden @ net["w2"] + net["b2"]) @ net["w3"] + net["b3"]


def loss(net, key, x, y, motor):
    """MSE + weight·KL of a batch."""
    mean = net["mean"]
    log_var = net["log_var"]
    noise = jax.random.normal(key, (len(motor), LATENTS))
    z = mean[motor] + jnp.exp(0.5 * log_var[motor]) * noise
    predicted = f(net, x, z)
    kl = 0.5 * jnp.sum(jnp.exp(log_var) + mean**2 - 1.0 - log_var, axis=1)
    return jnp.mean((predicted - y) ** 2) + KL_WEIGHT * jnp.mean(kl)


rng = np.random.default_rng(0)
shapes = {
    "w1": (2 * TAPS, NEURONS),
    "v1": (LATENTS, NEURONS),
    "w2": (NEURONS, NEURONS),
    "w3": (NEURONS,),
}
net = {}
for name, shape in shapes.items():
    net[name] = jnp.array(rng.standard_normal(shape) / np.sqrt(shape[0]))
net["b1"] = jnp.zeros(NEURONS)
net["b2"] = jnp.zeros(NEURONS)
net["b3"] = jnp.zeros(())
net["mean"] = jnp.zeros((args.motors, LATENTS))
net["log_var"] = jnp.full((args.motors, LATENTS), -2.0)
adam = optax.adam(optax.cosine_decay_schedule(3e-3, args.steps))


@jax.jit
def update(net, state, key, x, y, motor):
    """One Adam step."""
    change, state = adam.update(jax.grad(loss)(net, key, x, y, motor), state)
    return optax.apply_updates(net, change), state


state = adam.init(net)
keys = jax.random.split(jax.random.key(0), args.steps)
for key in keys:
    row = rng.integers(len(inputs), size=BATCH)
    motor = rng.integers(args.motors, size=BATCH)
    net, state = update(net, state, key, inputs[row, motor], outputs[row, motor], motor)

distribution = ("mean", "log_var")
weights = {
    name: np.asarray(value, float) for name, value in net.items() if name not in distribution
}
network = LatentNetwork(
    **weights,
    log_armature=np.zeros(()),
    armature_slope=np.zeros(LATENTS),
    taps=tuple(range(TAPS)),
    period=PERIOD,
    error_scale=error_scale,
    velocity_scale=velocity_scale,
    torque_scale=torque_scale,
    torque_limit=float(np.abs(torque).max()),
    has_armature=False,
)
z_of_first = np.asarray(net["mean"])[:1]
fitted = network.torque(inputs[:, 0], np.tile(z_of_first, (len(inputs), 1)))
residual = np.std(fitted - torque[TAPS - 1 :, 0])
print(f"torque of the first motor: error {residual:.3f} of {torque_scale:.3f} N·m", file=sys.stderr)

# 3 Motors of an episode: samples of the prior, an ideal PD, and physical motors that neither has
# seen.
joints = robot.joint_names
pose = robot.nominal_pose
kp = np.array([joint.kp for joint in robot.joints])
kd = np.array([joint.kd for joint in robot.joints])
limit = np.array([joint.torque_limit for joint in robot.joints])
ideal_pd = mp.IdealPd.without_friction(kp, kd, limit, np.zeros(12), np.zeros(12))


def motors_of_episode(name, seed):
    """Motors of this name for one episode."""
    if name == "prior":
        return network.motors(np.random.default_rng(seed).standard_normal((12, LATENTS)))
    if name == "ideal PD":
        return ideal_pd
    return fleet.sample(12, seed + 10_000).actuator()


PHASES = np.array([leg.phase for leg in robot.legs])
FREQUENCY = 3.0  # of the gait [Hz]
STRIDE = 0.25  # [rad]
LIFT = 0.25  # [rad]
MAX_TILT = 0.8  # beyond it the robot fell [rad]
OBSERVATIONS = 8
ACTIONS = 15


# 4 The gait: hips swing, legs fold while they swing forward; the policy changes its size, and every
# joint a little.
def walk(policy, name, seed):
    """Distance forward [m] and share of the time upright."""
    model = build_model(robot, 0.001 if name == "held-out" else 0.002)
    data = mujoco.MjData(model)
    data.qpos[7:] = pose
    motors = mp.DrivenJoints(model, data, motors_of_episode(name, seed), joints)
    phase = 0.0
    steps = round(args.seconds / PERIOD)
    for step in range(steps):
        # what the policy sees
        w, x, y, z = data.qpos[3:7]
        roll = 2.0 * (w * x + y * z)
        pitch = 2.0 * (w * y - z * x)
        clock = 2.0 * np.pi * phase
        rates = 0.1 * data.qvel[3:6]
        observation = np.array([roll, pitch, *rates, np.sin(clock), np.cos(clock), 1.0])

        # the trajectory generator that it modulates
        action = np.tanh(policy @ observation)
        phase += PERIOD * FREQUENCY * (1.0 + 0.3 * action[0])
        leg = 2.0 * np.pi * (phase + PHASES)
        swing = STRIDE * (1.0 + action[1]) * np.cos(leg)
        lift = LIFT * (1.0 + action[2]) * np.maximum(0.0, np.sin(leg))
        target = (pose + 0.2 * action[3:]).reshape(4, 3)
        target += np.stack([0.0 * leg, swing + lift, -2.0 * lift], axis=1)

        for _ in range(round(PERIOD / model.opt.timestep)):
            motors.drive(target.ravel())
            mujoco.mj_step(model, data)
        is_low = data.qpos[2] < robot.min_base_height
        if is_low or abs(roll) > MAX_TILT or abs(pitch) > MAX_TILT:
            return data.qpos[0], step / steps
    return data.qpos[0], 1.0


def train(name, noise=0.05, step_size=0.05):
    """Augmented random search (Mania et al., 2018): steps along the best of random directions."""
    policy = np.zeros((ACTIONS, OBSERVATIONS))
    rng = np.random.default_rng(1)
    for iteration in range(args.iterations):
        deltas = rng.standard_normal((args.directions, *policy.shape))
        returns = np.zeros((args.directions, 2))  # of the policies policy ± noise·delta
        for index, delta in enumerate(deltas):
            seed = 1000 * iteration + index
            for column, sign in enumerate((1, -1)):
                distance, upright = walk(policy + sign * noise * delta, name, seed)
                returns[index, column] = distance * upright

        best = np.argsort(returns.max(axis=1))[-(args.directions + 1) // 2 :]
        differences = returns[best, 0] - returns[best, 1]
        gradient = np.tensordot(differences, deltas[best], 1) / len(best)
        policy = policy + step_size * gradient / (returns[best].std() + 1e-6)
        print(f"{name}, iteration {iteration}: mean return {returns.mean():.2f} m", file=sys.stderr)
    return policy


# 5 Transfer: distance and time upright in the training simulation and on held-out motors.
for name in ("prior", "ideal PD"):
    policy = train(name)
    for motors in (name, "held-out"):
        walks = [walk(policy, motors, 500 + seed) for seed in range(8)]
        distance, upright = np.mean(walks, axis=0)
        speed = distance / args.seconds
        print(
            f"trained on {name}, on {motors} motors: {speed:.2f} m/s, upright {100 * upright:.0f} %"
        )
