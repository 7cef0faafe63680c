"""``cablebot validate``."""

import pytest
from reality.synthetic import sagging, source_of, written

from cablebot_winches.reality.sources import SOURCES


@pytest.fixture
def logs(tmp_path, monkeypatch):
    """Folder with synthetic logs, which the study expects."""
    files = sagging(copied=[3, 7])
    monkeypatch.setitem(SOURCES, "innopolis", source_of(files))
    return written(files, tmp_path / "logs")


def test_table_and_figure_of_a_study(cablebot, logs, tmp_path):
    pytest.importorskip("matplotlib")
    ended = cablebot("validate innopolis --logs", logs, "--out", tmp_path / "sag.svg")
    assert ended.status == 0
    for text in ("owner/name at ccccccc", "1.5 mm/kg", "10 % │  yes", "2 of the 50 points"):
        assert text in ended.out
    assert (tmp_path / "sag.svg").read_text().count("<svg") == 1


def test_json_has_source_and_quantities_in_si_units(cablebot, logs):
    data = cablebot("validate innopolis --json --logs", logs).data
    assert data["command"] == "cablebot validate innopolis"
    assert len(data["files"]) == 3
    slopes = [item for item in data["comparisons"] if item["quantity"] == "sag per load, mean"]
    assert slopes[0]["robot"] == pytest.approx(1.5e-3)
    assert slopes[0]["unit"] == "m/kg"


@pytest.mark.parametrize(
    ("typed", "message"),
    [
        ("validate ttk", "unknown study 'ttk'; choose one of ttk4900"),
        ("validate ttk4900 --logs nowhere", "'nowhere' is no folder"),
        ("validate ttk4900 --logs . --out a.gif", "--out must end in .svg, .png or .pdf"),
        ("validate ttk4900 --logs .", "has no file Up05.csv. Download https://raw.github"),
    ],
)
def test_mistake_is_named_in_one_line(cablebot, typed, message):
    assert message in cablebot(typed).message(2)


def test_missing_network_is_a_failure(cablebot, cache, monkeypatch):
    def refuse(*_, **__):
        raise OSError("no route")

    monkeypatch.setattr("socket.create_connection", refuse)
    message = cablebot("validate innopolis").message(1)
    assert "cannot download https://raw.githubusercontent.com/Aydar" in message
    assert "--logs" in message
