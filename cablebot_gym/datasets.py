"""Description of a Minari dataset of these environments: a datasheet, and metadata in Croissant for
programs.

Requires the extra ``minari``. Facts come from the dataset, and blocks and units from the
environment's layout.
"""

from __future__ import annotations

import hashlib
import json
from datetime import date
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cablebot_gym.envs.single import CableBotEnv
from cablebot_gym.robots import KIND_TEXTS, Robot
from cablebot_gym.utils.files import atomic_write_text

if TYPE_CHECKING:
    from minari import MinariDataset

__all__ = ["describe_dataset"]

_COLLECTION = """The data are simulated. A policy ({algorithm}) acts in {env_id}, which is made with {kwargs}.
The reference motion is {motion}, unless the options of an episode name another. Minari {minari} records
actions and observations {frequency:g} times per second of simulated time. Required packages: {requirements}.
Code: {code}"""

_USES = """Imitation learning, offline reinforcement learning, and identification of models of cable-suspended robots. A
policy is evaluated in the environment, not on this dataset."""

_LIMITATIONS = """The plant is a model: {platform} on straight cables without mass (transmission: {springs}), with the
uncertainty that the keywords and options name and no other. Conclusions about a real robot need a test on that robot.
The data cover the policy, robot, motions and payloads named here; other states may be absent."""


def limitations(robot: Robot) -> str:
    """What the plant of a robot leaves out, for a datasheet."""
    return _LIMITATIONS.format(platform=KIND_TEXTS[robot.kind], springs=robot.springs)


_DATASHEET = """# Datasheet of {id}

The questions follow Gebru et al., *Datasheets for Datasets* (2021). Units are SI.

## Motivation

{purpose}

Created by {author} ({email}).

## Composition

{description}

{episodes} episodes with {steps} steps in `data/main_data.hdf5` ({size:.1f} MB). An episode has `observations`
(steps + 1, {components}), and `actions` (steps, {motors}), `rewards`, `terminations` and `truncations` (steps). An
action has one number for each motor: 1 requests the upper, −1 the lower torque limit at the present motor speed.
The data are complete, synthetic and about no person. There is no recommended split.

| episode | seed | options | steps | return | ended by |
|---:|---:|---|---:|---:|---|
{table}

Columns of an observation{normalised}:

{layout}

## Collection

{collection}

## Preprocessing

None. The observations and actions are those of the episodes, to the last bit: with the packages above, the same seeds,
options and actions give the same observations.

## Uses

{uses}

{limitations}

## Distribution

License: {license}. `croissant.json` beside this file describes the data for machines, with the checksum of the file.

## Maintenance

Contact: {author} ({email}). The version is part of the name: a changed dataset gets a new one. The environment's id has
a version too, and an environment with another behaviour gets another id.
"""


_CONTEXT = files("cablebot_gym") / "croissant_context.json"
"""The JSON-LD context of Croissant 1.1."""

_FILE = "main_data.hdf5"
"""File with the episodes of a Minari dataset."""

_REQUIRED = (
    "author",
    "author_email",
    "description",
    "algorithm_name",
    "code_permalink",
    "requirements",
)
"""Arguments of Minari's ``create_dataset`` without which a dataset cannot be described."""


def describe_dataset(
    dataset: MinariDataset, *, license: str, purpose: str, published: date
) -> tuple[Path, Path]:
    """Writes ``DATASHEET.md`` and ``croissant.json`` into the folder of a Minari dataset.

    Args:
        dataset: a dataset of one of this package's environments, with author, e-mail, description,
            algorithm and code.
        license: SPDX identifier or address of the license of the data.
        purpose: why the dataset was made, in one or more sentences.
        published: date of publication.

    Returns:
        The paths of both files.

    Raises:
        ValueError: if the dataset is not of this package's environments, a wrapper changed their
            observations, or the dataset was created without author, e-mail, description, algorithm,
            code or requirements.
    """
    env = dataset.recover_environment()
    _check_dataset(dataset, env.unwrapped)
    file = Path(dataset.spec.data_path) / _FILE
    facts = _facts(dataset, env.unwrapped, file)
    env.close()
    facts |= {"license": license, "purpose": purpose}
    sheet = file.parents[1] / "DATASHEET.md"
    croissant = file.parents[1] / "croissant.json"
    atomic_write_text(sheet, _DATASHEET.format(**facts))
    description = _croissant(dataset, env.unwrapped, facts, file, published)
    atomic_write_text(croissant, json.dumps(description, indent=1, ensure_ascii=False) + "\n")
    return sheet, croissant


def _check_dataset(dataset: MinariDataset, env: Any) -> None:
    """Checks that a dataset has the observations of an environment and all metadata."""
    shape = dataset.observation_space.shape
    if not isinstance(env, CableBotEnv) or shape != (env.layout.size,):
        raise ValueError(
            f"dataset {dataset.id!r} does not have the observations of an environment of cablebot_gym: record it "
            "without wrappers that change observations"
        )
    metadata = dataset.storage.metadata
    missing = [name for name in _REQUIRED if not metadata.get(name)]
    if missing:
        raise ValueError(
            f"dataset {dataset.id!r} lacks {', '.join(missing)}: give them to create_dataset()"
        )


def _facts(dataset: MinariDataset, env: CableBotEnv, file: Path) -> dict[str, Any]:
    """Values for the templates."""
    metadata: dict[str, Any] = dict(dataset.storage.metadata)
    normalised = ""
    if env.settings.normalised_observation:
        normalised = ", which are normalised: (value − centre)/scale"
    env_id = ""
    keywords = {}
    if env.spec is not None:
        env_id = env.spec.id
        keywords = env.spec.kwargs
    facts = {
        "id": dataset.id,
        "author": ", ".join(metadata["author"]),
        "email": ", ".join(metadata["author_email"]),
        "description": metadata["description"],
        "episodes": dataset.total_episodes,
        "steps": dataset.total_steps,
        "size": file.stat().st_size / 1e6,
        "components": env.layout.size,
        "motors": env.task.robot.cables,
        "normalised": normalised,
        "table": "\n".join(_episodes(dataset)),
        "layout": env.layout.table(),
        "algorithm": metadata["algorithm_name"],
        "env_id": env_id,
        "kwargs": json.dumps(keywords),
        "motion": env.task.trajectory.name,
        "frequency": env.task.control_frequency,
        "minari": dataset.minari_version,
        "requirements": ", ".join(metadata["requirements"]),
        "code": metadata["code_permalink"],
    }
    facts["collection"] = _one_line(_COLLECTION.format(**facts))
    facts["uses"] = _one_line(_USES)
    facts["limitations"] = _one_line(limitations(env.task.robot))
    return facts


def _one_line(text: str) -> str:
    return " ".join(text.split())


def _episodes(dataset: MinariDataset) -> list[str]:
    """Rows of the table of episodes."""
    rows = []
    metadata = dataset.storage.get_episode_metadata(dataset.episode_indices)
    for episode, stored in zip(dataset, metadata, strict=True):
        ended = "recording"
        if episode.terminations[-1]:
            ended = "termination"
        elif episode.truncations[-1]:
            ended = "truncation"
        options = json.dumps(stored.get("options") or {}, default=float)
        reward = episode.rewards.sum()
        rows.append(
            f"| {episode.id} | {stored.get('seed')} | `{options}` | {len(episode)} | {reward:.1f} | {ended} |"
        )
    return rows


def _croissant(
    dataset: MinariDataset, env: CableBotEnv, facts: dict[str, Any], file: Path, published: date
) -> dict[str, Any]:
    """Croissant 1.1: the file, the arrays of an episode, and the columns of its observations by
    block."""
    return {
        "@context": json.loads(_CONTEXT.read_text(encoding="utf-8")),
        "@type": "sc:Dataset",
        "conformsTo": [
            "http://mlcommons.org/croissant/1.1",
            "http://mlcommons.org/croissant/RAI/1.0",
        ],
        "name": dataset.id.replace("/", "-"),
        "description": f"{facts['description']}. {facts['purpose']}",
        "url": facts["code"],
        "license": facts["license"],
        "version": f"{dataset.spec.version or 0}.0.0",
        "datePublished": published.isoformat(),
        "creator": {"@type": "sc:Person", "name": facts["author"], "email": facts["email"]},
        "citeAs": f"{facts['author']}: {dataset.id}, {published.year}. {facts['code']}",
        "rai:dataCollection": facts["collection"],
        "rai:dataUseCases": facts["uses"],
        "rai:dataLimitations": facts["limitations"],
        "rai:personalSensitiveInformation": "None. The data are simulated.",
        "distribution": [_file_object(file)],
        "recordSet": [_episode_arrays(dataset, facts), _observation_blocks(dataset, env)],
    }


def _file_object(file: Path) -> dict[str, Any]:
    return {
        "@type": "cr:FileObject",
        "@id": _FILE,
        "name": _FILE,
        "description": "All episodes, in Minari's layout: the group episode_N has the arrays of episode N.",
        "contentUrl": f"data/{_FILE}",
        "contentSize": f"{file.stat().st_size} B",
        "encodingFormat": "application/x-hdf5",
        "sha256": hashlib.sha256(file.read_bytes()).hexdigest(),
    }


def _episode_arrays(dataset: MinariDataset, facts: dict[str, Any]) -> dict[str, Any]:
    """Record set of the arrays of each episode."""
    observations = str(dataset.observation_space.dtype)
    actions = str(dataset.action_space.dtype)
    columns = f"-1,{facts['components']}"
    motors = f"-1,{facts['motors']}"
    failed = "Whether the step ended a failed episode."
    complete = "Whether the step ended the motion."
    return _record_set(
        "episode",
        "Arrays of each episode, with one row for each control period.",
        [
            _array("observations", observations, columns, "One row more than actions."),
            _array("actions", actions, motors, "Normalised action of each motor."),
            _array("rewards", "float64", "-1", "Reward of each step."),
            _array("terminations", "bool", "-1", failed),
            _array("truncations", "bool", "-1", complete),
        ],
    )


def _observation_blocks(dataset: MinariDataset, env: CableBotEnv) -> dict[str, Any]:
    """Record set of the blocks of the observations."""
    dtype = str(dataset.observation_space.dtype)
    fields = []
    for block in env.layout.blocks:
        unit = block.unit.replace("–", "no unit")
        if env.settings.normalised_observation:
            unit = "normalised"
        columns = f"observations[:, {block.start}:{block.start + block.size}]"
        text = f"{block.meaning} [{unit}]"
        fields.append(_field(f"observation/{block.name}", columns, dtype, f"-1,{block.size}", text))
    return _record_set("observation", "Blocks of the observations of each episode.", fields)


def _record_set(name: str, description: str, fields: list[dict[str, Any]]) -> dict[str, Any]:
    return {
        "@type": "cr:RecordSet",
        "@id": name,
        "name": name,
        "description": description,
        "field": fields,
    }


def _array(name: str, dtype: str, shape: str, description: str) -> dict[str, Any]:
    return _field(f"episode/{name}", name, dtype, shape, description)


def _field(name: str, column: str, dtype: str, shape: str, description: str) -> dict[str, Any]:
    """A field of a record set: an array of each episode, or columns of one."""
    data_type = f"cr:{dtype.capitalize()}"
    if dtype == "bool":
        data_type = "sc:Boolean"
    return {
        "@type": "cr:Field",
        "@id": name,
        "name": name,
        "description": description,
        "dataType": data_type,
        "isArray": True,
        "arrayShape": shape,
        "source": {
            "fileObject": {"@id": _FILE},
            "extract": {"column": f"episode_*/{column}"},
        },
    }
