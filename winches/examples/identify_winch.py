"""Writes logs of a winch that lifts and lowers two masses, as a test bench would, for ``cablebot
identify``.

python winches/examples/identify_winch.py
"""

import csv
import math
import random
from pathlib import Path

FOLDER = Path("lifts")
PERIOD, RADIUS = 0.005, 0.05
FRICTION, PER_LOAD, DAMPING, INERTIA = 0.05, 0.04, 0.01, 8e-4
HEADER = ("time", "speed_1", "torque_1", "load_1")

random.seed(0)
FOLDER.mkdir(exist_ok=True)
for load in (2.0, 6.0):
    rows = []
    for step in range(8000):
        time = PERIOD * step
        # up and down at slowly growing speeds
        amplitude, rate = 2.0 + 0.4 * time, 1.5
        speed = amplitude * math.sin(rate * time)
        acceleration = 0.4 * math.sin(rate * time) + amplitude * rate * math.cos(rate * time)
        direction = speed / math.hypot(speed, 0.5)
        torque = RADIUS * load * (9.81 + RADIUS * acceleration) * (1 + PER_LOAD * direction)
        torque += FRICTION * direction + DAMPING * speed + INERTIA * acceleration
        rows.append((time, speed, torque + random.gauss(0, 0.02), load))
    with (FOLDER / f"{load:g}kg.csv").open("w", newline="") as file:
        csv.writer(file).writerows([HEADER, *rows])
print(f"wrote {FOLDER}/2kg.csv and {FOLDER}/6kg.csv")
