"""Rows with made-up results."""

from cablebot_gym.benchmark.rows import Row
from cablebot_gym.evaluation.conditions import Conditions

PLANAR = "CableBot-Planar-v0"
CIRCLE = {"name": "circle-planar"}


def asked(measure="payload", policy="", motion=CIRCLE, env_id=PLANAR, search=None, **conditions):
    """A row without result."""
    return Row(
        measure=measure,
        policy=policy,
        conditions=Conditions(env_id=env_id, trajectory=motion, **conditions),
        search=search or {},
    )


def answered(row, final=True, **result):
    """The row with a result of unknown code."""
    return Row(
        **vars(row)
        | {
            "result": result,
            "code": "a" * 16,
            "versions": {"python": "3.11"},
            "seconds": 1.0,
            "final": final,
        }
    )


def optimum(payload, motion=CIRCLE, env_id=PLANAR):
    """The optimum of a motion; None if the search found none."""
    result = {"error": "no motion"} if payload is None else {"payload": payload}
    return answered(asked("optimum", motion=motion, env_id=env_id), **result)


def verified(payload, motion=CIRCLE):
    """The best known payload of a motion."""
    return answered(asked("best-known", motion=motion), payload=payload, verified=True)


def carries(policy, payload, motion=CIRCLE, more=None, **conditions):
    """The payload of a policy; None if it fails unloaded."""
    mass = None if payload is None else payload + 1.0
    row = asked(policy=policy, motion=motion, **conditions)
    return answered(row, payload=payload, total_mass=mass, **(more or {}))


def fails(policy, message="it raised", motion=CIRCLE, **more):
    """A policy that raised an error."""
    return answered(asked(policy=policy, motion=motion), error=message, **more)


def drawn(motion, ratio, **more):
    """A random robot on a motion."""
    row = asked("drawn", motion=motion, uncertainty="hardware", **more)
    return answered(row, ratio=ratio)
