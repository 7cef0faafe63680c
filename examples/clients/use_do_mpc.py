# /// script
# dependencies = ["cablebot-gym", "do-mpc"]
# ///
"""do-mpc: a predictive controller. The inverse dynamics turn its accelerations into actions."""

import do_mpc
import gymnasium as gym
import numpy as np

import cablebot_gym
from cablebot_gym import inverse_dynamics, normalised_action, record_rollout
from cablebot_gym.robots import PLANAR

ENV_ID, FREQUENCY, AHEAD = cablebot_gym.ENV_IDS[0], 100, 10
env = gym.make(ENV_ID, control_frequency=FREQUENCY).unwrapped
env.reset()
motion = env.task.trajectory

model = do_mpc.model.Model("continuous")
pose, velocity = (model.set_variable("_x", name, (2, 1)) for name in ("pose", "velocity"))
acceleration = model.set_variable("_u", "acceleration", (2, 1))
reference = model.set_variable("_tvp", "reference", (2, 1))
model.set_rhs("pose", velocity)
model.set_rhs("velocity", acceleration)
model.setup()

mpc = do_mpc.controller.MPC(model)
mpc.set_param(n_horizon=AHEAD, t_step=1 / FREQUENCY)
mpc.settings.supress_ipopt_output()
error = 1e6 * ((pose - reference).T @ (pose - reference))
mpc.set_objective(mterm=error, lterm=error)
mpc.set_rterm(acceleration=1e-3)
template = mpc.get_tvp_template()


def references(time):
    for step in range(AHEAD + 1):
        template["_tvp", step, "reference"] = motion(np.squeeze(time).item() + step / FREQUENCY).position
    return template


mpc.set_tvp_fun(references)
mpc.setup()


def policy(observation):
    now = env.layout.split(observation)
    mpc.t0 = np.array([motion.duration - now["time_to_go"][0]])
    mpc.x0 = np.concatenate([now["pose"], now["velocity"]])
    if mpc.t0 == 0:
        mpc.set_initial_guess()
    wanted = mpc.make_step(mpc.x0)[:, 0]
    mass = PLANAR.mass + now["model_payload"][0]
    needed = inverse_dynamics(PLANAR, mass, now["pose"], now["velocity"], wanted, minimum=5.0)
    return normalised_action(PLANAR, needed.torques, needed.speeds)


rollout = record_rollout(policy, ENV_ID, payload=0.5, control_frequency=FREQUENCY)
outcome = rollout.verdict.violation or "no violation"
print(f"0.5 kg: largest position error {1e3 * rollout.verdict.position_peak:.2f} mm, {outcome}")
