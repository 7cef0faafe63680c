"""Evaluates your own robot: the paper's planar one with other motors.

Run it: python examples/your_robot.py
"""

from cablebot_gym import evaluate_dlcc
from cablebot_gym.robots import PLANAR, Motors

if __name__ == "__main__":
    for stall_torque in (4.0, 5.0, 8.0):
        motors = Motors(stall_torque=stall_torque, free_speed=PLANAR.motors.free_speed)
        robot = PLANAR.replace(name=f"{stall_torque:g} N·m", motors=motors)
        result = evaluate_dlcc("fl", "CableBot-Planar-v0", robot=robot)
        print(f"{robot.name}: {result.score:.2f} kg, limiting violation: {result.violation_text}")
    try:
        PLANAR.replace(home_pose=(2.0, 0.0))  # outside the cables
    except ValueError as error:
        print(f"refused: {error}")
