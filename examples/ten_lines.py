"""Makes an environment and evaluates three policies. Extra sb3. Run it: python examples/ten_lines.py"""

import gymnasium as gym

from cablebot_gym import evaluate_dlcc

env = gym.make("CableBot-Spatial-v0", payload=2.0)
observation, info = env.reset(seed=0)
observation, reward, terminated, truncated, info = env.step(env.action_space.sample())
print(f"{observation.size} numbers observed, {env.action_space.shape[0]} motors")

for policy in ("fl", "observing", "learned-plan"):
    result = evaluate_dlcc(policy, "CableBot-Spatial-v0")
    print(f"{policy} carries {result.payload:.2f} kg, then the {result.violation_text}")
