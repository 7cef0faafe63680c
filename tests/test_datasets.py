"""The description of a Minari dataset has the facts of its file and of the environment's layout."""

import gc
import hashlib
import json
import warnings
from datetime import date

import gymnasium as gym
import h5py
import minari
import numpy as np
import pytest

import cablebot_gym  # noqa: F401 - registers the ids
from cablebot_gym.datasets import describe_dataset
from cablebot_gym.envs.observation import observation_layout
from cablebot_gym.robots import PLANAR

PAYLOADS = 0.25, 1.5
ORIGIN = {
    "algorithm_name": "zero",
    "author": "A. Author",
    "author_email": "author@example.org",
    "code_permalink": "https://example.org",
    "description": "Two short episodes without torque",
    "requirements": ["cablebot-gym"],
}
ABOUT = {"license": "MIT", "purpose": "A test.", "published": date(2026, 1, 31)}


def recorded(env, name, **origin):
    """A Minari dataset of two episodes of five steps."""
    with warnings.catch_warnings():
        # Minari leaves its temporary folders to the garbage collector
        warnings.simplefilter("ignore", ResourceWarning)
        collector = minari.DataCollector(env)
        for seed, payload in enumerate(PAYLOADS):
            collector.reset(seed=seed, options={"payload": payload})
            for _ in range(5):
                collector.step(np.zeros(env.action_space.shape, env.action_space.dtype))
        dataset = collector.create_dataset(name, eval_env="CableBot-Planar-v0", **(ORIGIN | origin))
        collector.close()
        del collector
        gc.collect()
    return dataset


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("datasets")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("MINARI_DATASETS_PATH", str(folder))
        yield folder


@pytest.fixture(scope="module")
def described(folder):
    sheet, croissant = describe_dataset(
        recorded(gym.make("CableBot-Planar-v0"), "test/zero-v3"), **ABOUT
    )
    return (
        sheet.read_text(encoding="utf-8"),
        json.loads(croissant.read_text(encoding="utf-8")),
        sheet.parent,
    )


def test_croissant_has_the_arrays_of_the_file(described):
    _, croissant, folder = described
    (file,) = croissant["distribution"]
    content = (folder / file["contentUrl"]).read_bytes()
    assert file["sha256"] == hashlib.sha256(content).hexdigest()
    fields = croissant["recordSet"][0]["field"]
    with h5py.File(folder / file["contentUrl"]) as data:
        assert {field["@id"].partition("/")[2] for field in fields} == set(data["episode_0"]) - {
            "infos"
        }
        for field in fields:
            array = data[field["source"]["extract"]["column"].replace("*", "1")]
            assert field["arrayShape"].split(",") == [
                "-1",
                *map(str, array.shape[1:]),
            ]
            assert field["dataType"] == {"bool": "sc:Boolean"}.get(
                array.dtype.name, f"cr:{array.dtype.name.title()}"
            )
            assert field["source"]["fileObject"]["@id"] == file["@id"]


def test_croissant_has_the_blocks_of_the_layout(described):
    layout = observation_layout(PLANAR)
    fields = described[1]["recordSet"][1]["field"]
    for block, field in zip(layout.blocks, fields, strict=True):
        columns = f"episode_*/observations[:, {block.start}:{block.start + block.size}]"
        assert field["source"]["extract"]["column"] == columns
        assert block.meaning in field["description"]
        assert block.name != "model_payload" or "[kg]" in field["description"]


def test_datasheet_has_episodes_and_layout(described):
    sheet, croissant, _ = described
    rows = [line.split(" | ")[:4] for line in sheet.splitlines() if '{"payload"' in line]
    assert rows == [
        [f"| {n}", str(n), f'`{{"payload": {payload}}}`', "5"] for n, payload in enumerate(PAYLOADS)
    ]
    assert observation_layout(PLANAR).table() in sheet
    assert croissant["rai:dataCollection"] in sheet
    assert (croissant["version"], croissant["datePublished"]) == (
        "3.0.0",
        "2026-01-31",
    )


def test_dataset_without_layout_or_author_is_rejected(folder):
    stacked = gym.wrappers.FrameStackObservation(gym.make("CableBot-Planar-v0"), 2)
    with pytest.raises(ValueError, match="without wrappers"):
        describe_dataset(recorded(stacked, "test/stacked-v0"), **ABOUT)
    with pytest.raises(ValueError, match="lacks requirements"):
        describe_dataset(
            recorded(gym.make("CableBot-Planar-v0"), "test/plain-v0", requirements=[]),
            **ABOUT,
        )
