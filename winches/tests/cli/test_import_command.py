"""``cablebot robot import``."""

from test_importers import wirex

from cablebot_gym.robots import load_robot


def test_import_says_what_is_assumed_and_keeps_an_edited_file(cablebot, tmp_path):
    path = tmp_path / "toy.wcrfx"
    path.write_text(wirex())
    out = tmp_path / "toy.toml"
    ended = cablebot("robot import", path, "--out", out)
    assert ended.status == 0
    assert "from file  mass: " in ended.out
    assert "assumed    transmission.damping: no friction" in ended.out
    assert ended.err.endswith(f"cablebot robot check {out}\n")
    assert load_robot(out).mass == 5
    assert "may have been edited" in cablebot("robot import", path, "--out", out).message(2)
    assert "must end in .toml" in cablebot("robot import toy.wcrfx --out toy.xml").message(2)


def test_group_lists_the_command_beside_those_of_the_core(cablebot):
    shown = cablebot("robot --help").out
    for name in ("check", "export", "import"):
        assert f" {name} " in shown
