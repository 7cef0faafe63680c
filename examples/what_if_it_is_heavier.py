"""Compares three laws under the same draws of mass, external force and sensor noise.

Run it: python examples/what_if_it_is_heavier.py
"""

from cablebot_gym import compare_policies, evaluate_dlcc

UNCERTAINTY = {
    "parameters": {"platform_mass": {"low": 0.0, "high": 0.2}},
    "wrench": {"force_std": 0.5},
    "sensors": {"position": 2e-5, "velocity": 5e-4},
}

if __name__ == "__main__":
    laws = ("fl", "fl:gains=tuned", "observing")
    compared = compare_policies(
        laws, "CableBot-Spatial-v0", payload=2.0, uncertainty=UNCERTAINTY, draws=16
    )
    for one in compared.metrics:
        print(f"{one.policy}: {one.carried.mean():.0%} of the draws carry 2 kg")
    print(
        evaluate_dlcc(
            "observing",
            "CableBot-Spatial-v0",
            uncertainty=UNCERTAINTY,
            draws=8,
            probability=0.75,
            payload_max=8,
        )
    )
