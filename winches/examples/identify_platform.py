"""Writes logs of a moving platform with elastic cables for ``cablebot identify``: recordings of the
simulator in the columns of a log, with noise and encoder steps.

python winches/examples/identify_platform.py
"""

import csv
from pathlib import Path

import numpy as np

from cablebot_gym import find_robot, record_rollout

ENV_ID, POLICY = "CableBot-FlexPlanarPlatform-v0", "composite"
FOLDER = Path("motions")
POSITION_NOISE, ROTATION_NOISE, TORQUE_NOISE, TENSION_NOISE = 1e-4, 5e-4, 0.01, 0.3
ENCODER_STEP = 2 * np.pi / 8192
HEADER = ["time", "x", "y", "phi", "payload"]
for quantity in ("angle", "speed", "torque", "tension"):
    HEADER += [f"{quantity}_{motor}" for motor in (1, 2, 3, 4)]

nominal = find_robot("flex-gch-klaus")
transmission = nominal.transmission.replace(axial_stiffness=15e3, coulomb_friction=0.045)
true = nominal.replace(transmission=transmission)
rng = np.random.default_rng(0)
FOLDER.mkdir(exist_ok=True)
for payload in (0.3, 1.0):
    arrays = record_rollout(POLICY, ENV_ID, robot=true, payload=payload).arrays
    # A recording has poses and angles at the end of a step, torques and tensions at its start.
    time = arrays["action_time"][1:]
    pose = arrays["true_pose"][:-1]
    pose_noise = [POSITION_NOISE, POSITION_NOISE, ROTATION_NOISE]
    torque, tension = arrays["torques"][1:], arrays["tensions"][1:]
    columns = [
        time[:, None],
        pose + rng.normal(0, pose_noise, pose.shape),
        np.full((len(time), 1), payload),
        ENCODER_STEP * np.round(arrays["motor_angle"][:-1] / ENCODER_STEP),
        arrays["motor_speeds"][1:],
        torque + rng.normal(0, TORQUE_NOISE, torque.shape),
        tension + rng.normal(0, TENSION_NOISE, tension.shape),
    ]
    with (FOLDER / f"{payload:g}kg.csv").open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(HEADER)
        for row in np.hstack(columns):
            writer.writerow([f"{value:.8g}" for value in row])
print(f"wrote {FOLDER}/0.3kg.csv and {FOLDER}/1kg.csv")
