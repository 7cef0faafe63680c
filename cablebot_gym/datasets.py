"""Description of a Minari dataset of these environments: a datasheet, and metadata in Croissant for
programs.

Requires the extra ``minari``. Facts come from the dataset, and blocks and units from the
environment's layout.
"""

from __future__ import annotations

import hashlib
import json
from datetime import date
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
    plain = env.unwrapped
    if not isinstance(plain, CableBotEnv) or dataset.observation_space.shape != (
        plain.layout.size,
    ):
        raise ValueError(
            f"dataset {dataset.id!r} does not have the observations of an environment of cablebot_gym: record it "
            "without wrappers that change observations"
        )
    data: dict[str, Any] = dict(dataset.storage.metadata)
    if missing := [name for name in _REQUIRED if not data.get(name)]:
        raise ValueError(
            f"dataset {dataset.id!r} lacks {', '.join(missing)}: give them to create_dataset()"
        )
    author = ", ".join(data["author"])
    email = ", ".join(data["author_email"])
    file = Path(dataset.spec.data_path) / "main_data.hdf5"
    facts = {
        "id": dataset.id,
        "author": author,
        "email": email,
        "description": data["description"],
        "purpose": purpose,
        "license": license,
        "episodes": dataset.total_episodes,
        "steps": dataset.total_steps,
        "size": file.stat().st_size / 1e6,
        "components": plain.layout.size,
        "motors": plain.task.robot.cables,
        "normalised": ", which are normalised: (value − centre)/scale"
        if plain.settings.normalised_observation
        else "",
        "table": "\n".join(_episodes(dataset)),
        "layout": plain.layout.table(),
        "algorithm": data["algorithm_name"],
        "env_id": plain.spec.id if plain.spec else "",
        "kwargs": json.dumps(plain.spec.kwargs if plain.spec else {}),
        "motion": plain.task.trajectory.name,
        "frequency": plain.task.control_frequency,
        "minari": dataset.minari_version,
        "requirements": ", ".join(data["requirements"]),
        "code": data["code_permalink"],
    }
    env.close()
    texts = {
        "collection": _COLLECTION.format(**facts),
        "uses": _USES,
        "limitations": limitations(plain.task.robot),
    }
    texts = {name: " ".join(text.split()) for name, text in texts.items()}
    sheet = file.parents[1] / "DATASHEET.md"
    croissant = file.parents[1] / "croissant.json"
    atomic_write_text(sheet, _DATASHEET.format(**facts, **texts))
    described = _croissant(dataset, plain, facts, texts, file=file, published=published)
    atomic_write_text(croissant, json.dumps(described, indent=1, ensure_ascii=False) + "\n")
    return sheet, croissant


def _episodes(dataset: MinariDataset) -> list[str]:
    rows = []
    for episode, kept in zip(
        dataset, dataset.storage.get_episode_metadata(dataset.episode_indices), strict=True
    ):
        ended = (
            "termination"
            if episode.terminations[-1]
            else "truncation"
            if episode.truncations[-1]
            else "recording"
        )
        options = f"`{json.dumps(kept.get('options') or {}, default=float)}`"
        row = (
            episode.id,
            kept.get("seed"),
            options,
            len(episode),
            f"{episode.rewards.sum():.1f}",
            ended,
        )
        rows.append(f"| {' | '.join(map(str, row))} |")
    return rows


_TERMS = (
    *(
        "arrayShape",
        "citeAs",
        "column",
        "containedIn",
        "equivalentProperty",
        "extract",
        "field",
        "fileObject",
    ),
    *(
        "fileProperty",
        "fileSet",
        "format",
        "includes",
        "isArray",
        "isLiveDataset",
        "jsonPath",
        "key",
        "md5",
    ),
    *(
        "parentField",
        "path",
        "recordSet",
        "references",
        "regex",
        "repeated",
        "replace",
        "samplingRate",
        "separator",
    ),
    *("source", "subField", "transform"),
)
"""Terms of Croissant 1.1 that its context names one by one."""


def _context() -> dict[str, Any]:
    return {
        "@language": "en",
        "@vocab": "https://schema.org/",
        "sc": "https://schema.org/",
        "cr": "http://mlcommons.org/croissant/",
        "rai": "http://mlcommons.org/croissant/RAI/",
        "dct": "http://purl.org/dc/terms/",
        "conformsTo": "dct:conformsTo",
        "name": {"@container": "@language"},
        "description": {"@container": "@language"},
        "data": {"@id": "cr:data", "@type": "@json"},
        "examples": {"@id": "cr:examples", "@type": "@json"},
        "dataType": {"@id": "cr:dataType", "@type": "@vocab"},
        **{term: f"cr:{term}" for term in _TERMS},
    }


def _croissant(
    dataset: MinariDataset,
    env: CableBotEnv,
    facts: dict[str, Any],
    texts: dict[str, str],
    *,
    file: Path,
    published: date,
) -> dict[str, Any]:
    """Croissant 1.1: the file, the arrays of an episode, and the columns of its observations by
    block."""
    version = f"{dataset.spec.version or 0}.0.0"

    def record(name: str, description: str, fields: list[dict[str, Any]]) -> dict[str, Any]:
        return {
            "@type": "cr:RecordSet",
            "@id": name,
            "name": name,
            "description": description,
            "field": fields,
        }

    def field(name: str, path: str, dtype: str, shape: str, description: str) -> dict[str, Any]:
        return {
            "@type": "cr:Field",
            "@id": name,
            "name": name,
            "description": description,
            "dataType": {"bool": "sc:Boolean"}.get(dtype, f"cr:{dtype.capitalize()}"),
            "isArray": True,
            "arrayShape": shape,
            "source": {"fileObject": {"@id": file.name}, "extract": {"column": path}},
        }

    observations = str(dataset.observation_space.dtype)
    actions = str(dataset.action_space.dtype)
    size, motors = facts["components"], facts["motors"]
    arrays = [
        field(
            "episode/observations",
            "episode_*/observations",
            observations,
            f"-1,{size}",
            "One row more than actions.",
        ),
        field(
            "episode/actions",
            "episode_*/actions",
            actions,
            f"-1,{motors}",
            "Normalised action of each motor.",
        ),
        field("episode/rewards", "episode_*/rewards", "float64", "-1", "Reward of each step."),
        field(
            "episode/terminations",
            "episode_*/terminations",
            "bool",
            "-1",
            "Whether the step ended a failed episode.",
        ),
        field(
            "episode/truncations",
            "episode_*/truncations",
            "bool",
            "-1",
            "Whether the step ended the motion.",
        ),
    ]
    blocks = []
    for block in env.layout.blocks:
        unit = (
            "normalised"
            if env.settings.normalised_observation
            else block.unit.replace("–", "no unit")
        )
        path = f"episode_*/observations[:, {block.start}:{block.start + block.size}]"
        text = f"{block.meaning} [{unit}]"
        blocks.append(
            field(f"observation/{block.name}", path, observations, f"-1,{block.size}", text)
        )
    return {
        "@context": _context(),
        "@type": "sc:Dataset",
        "conformsTo": [
            "http://mlcommons.org/croissant/1.1",
            "http://mlcommons.org/croissant/RAI/1.0",
        ],
        "name": dataset.id.replace("/", "-"),
        "description": f"{facts['description']}. {facts['purpose']}",
        "url": facts["code"],
        "license": facts["license"],
        "version": version,
        "datePublished": published.isoformat(),
        "creator": {"@type": "sc:Person", "name": facts["author"], "email": facts["email"]},
        "citeAs": f"{facts['author']}: {dataset.id}, {published.year}. {facts['code']}",
        "rai:dataCollection": texts["collection"],
        "rai:dataUseCases": texts["uses"],
        "rai:dataLimitations": texts["limitations"],
        "rai:personalSensitiveInformation": "None. The data are simulated.",
        "distribution": [
            {
                "@type": "cr:FileObject",
                "@id": file.name,
                "name": file.name,
                "description": "All episodes, in Minari's layout: the group episode_N has the arrays of episode N.",
                "contentUrl": f"data/{file.name}",
                "contentSize": f"{file.stat().st_size} B",
                "encodingFormat": "application/x-hdf5",
                "sha256": hashlib.sha256(file.read_bytes()).hexdigest(),
            }
        ],
        "recordSet": [
            record(
                "episode", "Arrays of each episode, with one row for each control period.", arrays
            ),
            record("observation", "Blocks of the observations of each episode.", blocks),
        ],
    }
