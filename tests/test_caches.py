"""Every cache on disk: a damaged file counts as absent, one line names it, and a good file replaces
it."""

from importlib.metadata import PackageNotFoundError

import numpy as np
import pytest

from cablebot_gym.motions import find_trajectory
from cablebot_gym.physics.compiling import code_cache
from cablebot_gym.physics.compiling.loading import cached_njit
from cablebot_gym.planning import PlannedMotion, library
from cablebot_gym.robots import PLANAR

MOTION = PlannedMotion(
    name="line",
    knots=np.linspace(0.0, 1.0, 500),
    poses=np.ones((500, 2)),
    motors=(),
    payload=1.0,
    lightest=0.0,
    minimum_tension=1.0,
)


def compiled_code(folder, monkeypatch):
    monkeypatch.setattr(code_cache, "code_folders", lambda: [folder])

    def triple(number):
        return 3 * number

    def use():
        compiled = cached_njit(triple)
        assert compiled(2) == 6
        return not compiled.stats.cache_hits

    return use


def plan(folder, monkeypatch):
    """Also for best known payloads, which are stored in the same way."""
    monkeypatch.setenv("CABLEBOT_CACHE", str(folder))

    def use():
        computed = []
        result = library.load_or_compute(
            "value.npz",
            library._read_plan,
            lambda: computed.append(1) or MOTION,
            library._plan_bytes,
        )
        assert result.payload == MOTION.payload
        return bool(computed)

    return use


CACHES = {
    "compiled code": compiled_code,
    "plan": plan,
}
"""Each makes a function that reads a value, or computes and stores it; it returns whether it was
computed."""

DAMAGES = {
    "truncated": lambda content: content[: len(content) // 2],
    # After a crash, file systems can fill blocks with zeros.
    "zeros": lambda content: content[: len(content) // 4] + bytes(len(content) - len(content) // 4),
}


@pytest.mark.parametrize("damage", DAMAGES)
@pytest.mark.parametrize("cache_name", CACHES)
def test_damaged_file_counts_as_absent(cache_name, damage, tmp_path, monkeypatch, caplog):
    folder = tmp_path / "cache"
    use = CACHES[cache_name](folder, monkeypatch)
    assert [use(), use()] == [True, False]
    (path,) = folder.iterdir()
    good = path.read_bytes()
    path.write_bytes(DAMAGES[damage](good))
    caplog.clear()
    assert [use(), use()] == [True, False]
    (message,) = [record.message for record in caplog.records if "damaged" in record.message]
    assert message.startswith(str(path))
    assert path.read_bytes() == good or cache_name == "compiled code"
    assert list(folder.iterdir()) == [path]


def test_networks_cache_plans_with_the_packages_that_are_installed(monkeypatch):
    """Networks plan without it."""

    def without_casadi(name):
        if name == "casadi":
            raise PackageNotFoundError(name)
        return "1.0"

    monkeypatch.setattr(library, "version", without_casadi)
    motion = find_trajectory("circle-planar", "planar")
    assert library.fingerprint("cablebot_gym.planning.motion", PLANAR, motion)
