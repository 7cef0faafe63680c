"""Robots from files of CASPR and WireX, against a computation in the frame of the files, where z
points up."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from cablebot_gym.physics import textbook
from cablebot_gym.physics.tensions.distribution import least_norm
from cablebot_gym.robots import load_robot
from cablebot_winches.importers import import_robot

BASE = [
    (sx * 2.0, sy * 1.5, z) for z in (2.0, 0.1) for sx, sy in ((-1, 1), (1, 1), (1, -1), (-1, -1))
]
BODY = [(0.2 * x, 0.3 * y, 0.25 - z / 4) for (x, y, z) in BASE]
CENTER = (0.02, -0.01, 0.03)
Z_DOWN = np.diag([1.0, -1.0, -1.0])
NAMES = ("Ixx", "Iyy", "Izz", "Ixy", "Ixz", "Iyz")


def bodies(
    joint="SPATIAL_EULER_XYZ",
    start="0.1 0 1 0.05 -0.06 0.04",
    ref="com",
    count=1,
    inertia=(1, 2, 2.5, 0.1, 0.2, 0),
):
    entries = "".join(
        f"<{name}>{value}</{name}>" for name, value in zip(NAMES, inertia, strict=True)
    )
    link = f"""<link_rigid num="1" name="x"><joint type="{joint}" q_initial="{start}"/>
      <physical><mass>5</mass><com_location>{" ".join(map(str, CENTER))}</com_location>
      <inertia ref="{ref}">{entries}</inertia></physical><parent><num>0</num><location>0 0 0.1</location></parent>
      </link_rigid>"""
    return f'<!DOCTYPE bodies_system SYSTEM "x.dtd"><bodies_system><links>{link * count}</links></bodies_system>'


def cables(base=BASE, body=BODY, reference="com", tag="cable_ideal", fixed="attachment"):
    items = "".join(
        f"""<{tag} name="c{i}" attachment_reference="{reference}"><properties><force_min>2</force_min>
        <force_max>{100 + i}</force_max></properties><attachments>
        <{fixed}><link>0</link><location>{" ".join(map(str, a))}</location></{fixed}>
        <attachment><link>1</link><location>{" ".join(map(str, b))}</location></attachment></attachments></{tag}>"""
        for i, (a, b) in enumerate(zip(base, body, strict=True))
    )
    return f'<cables default_cable_set="one"><cable_set id="one">{items}</cable_set><cable_set id="two"/></cables>'


def wirex(pattern="3R3T", inertia=(14,), center=(0, 1, 0.2)):
    entries = " ".join(f'{name}="{value}"' for name, value in zip(NAMES, inertia, strict=False))
    point = 'x="{}" y="{}" z="{}"'
    chains = "".join(
        f"<chain><base {point.format(*a)} radius='0.1'/><platform {point.format(*b)}/></chain>"
        for a, b in zip(BASE, BODY, strict=True)
    )
    return f"""<models><robot motionpattern="{pattern}"><geometry>{chains}</geometry>
      <platform mass="5"><inertiatensor {entries}/><centerofgravity {point.format(*center)}/></platform></robot>
      <cable elasticity="1e9" radius="0.001" weight="0.02"/><winch><cable f_max="720" max_velocity="1.5"/>
      <motor inertia="0.001" gear_ratio="3"/><drum r_drum="0.05"/></winch></models>"""


@pytest.fixture
def write(tmp_path):
    def write(**texts):
        paths = []
        for name, text in texts.items():
            paths.append(tmp_path / ("toy.wcrfx" if name == "wcrfx" else f"toy_{name}.xml"))
            paths[-1].write_text(text, encoding="utf-8-sig")
        return paths[0]

    return write


@pytest.mark.parametrize("source", ["caspr", "wirex"])
def test_lengths_and_tensions_at_rest_are_those_of_the_file(write, source):
    path = write(bodies=bodies(), cables=cables()) if source == "caspr" else write(wcrfx=wirex())
    robot = import_robot(path).robot
    center = np.array(CENTER if source == "caspr" else (0, 0, 0))
    weight = np.array([0, 0, 5 * 9.81])
    random = np.random.default_rng(0)
    for _ in range(5):
        position = np.array([0.0, 0.0, 1.0]) + random.uniform(-0.2, 0.2, 3)
        rotation = Rotation.from_euler("XYZ", random.uniform(-0.3, 0.3, 3))  # CASPR: intrinsic
        arms = rotation.apply(BODY + center)
        ropes = np.array(BASE) - position - arms
        lengths = np.linalg.norm(ropes, axis=1)
        units = ropes / lengths[:, None]
        carried = np.concatenate([weight, np.cross(rotation.apply(center), weight)])
        tensions = np.linalg.pinv(np.vstack([units.T, np.cross(arms, units).T])) @ carried
        pose = np.concatenate([Z_DOWN @ position, euler_angles(rotation)])
        assert_allclose(textbook.cable_lengths(robot, pose), lengths, atol=1e-12)
        load = textbook.bias(robot, 5.0, pose, np.zeros(6))
        least = least_norm(textbook.jacobian(robot, pose), load, -1e9, 1e9, np.zeros(8))
        assert_allclose(least.tensions, tensions, atol=1e-9)


def euler_angles(rotation):
    """Angles of a pose, of a rotation in the frame of a file."""
    turned = Rotation.from_matrix(Z_DOWN @ rotation.as_matrix() @ Z_DOWN)
    return turned.as_euler("ZYX")[::-1]


def test_values_of_a_caspr_file_reach_the_robot(write, tmp_path):
    imported = import_robot(write(bodies=bodies(), cables=cables()))
    robot = imported.robot
    tensor = [[1, 0.1, 0.2], [0.1, 2, 0], [0.2, 0, 2.5]]
    assert_allclose(robot.inertia_tensor, Z_DOWN @ tensor @ Z_DOWN)
    assert_allclose(robot.stall_torque / robot.pulley_radius, 100 + np.arange(8), rtol=1e-5)
    turn = Rotation.from_euler("XYZ", [0.05, -0.06, 0.04])
    assert_allclose(robot.home, [0.1, 0, -1.1, *euler_angles(turn)], atol=1e-5)
    assert (robot.mass, robot.minimum_tension) == (5.0, 2.0)
    assumed = {name for name, text in imported.sources.items() if text.startswith("assumed")}
    shafts = ("pulley_radius", "pulley_inertia", "damping")
    motors = {"motors.stall_torque", "motors.free_speed"}
    assert assumed == motors | {f"transmission.{name}" for name in shafts}
    (tmp_path / "toy.toml").write_text(imported.to_toml(), encoding="utf-8")
    again = load_robot(tmp_path / "toy.toml")
    assert (again, again.sources) == (robot, robot.sources)


def inertia_matrix(points):
    """Inertia tensor of points of 1 kg about the origin, ∑ m (r² 1 − r rᵀ)."""
    matrix = np.zeros((3, 3))
    for point in points:
        matrix += point @ point * np.eye(3) - np.outer(point, point)
    return matrix


@pytest.mark.parametrize(
    ("program", "reference"), [("caspr", "com"), ("caspr", "joint"), ("wirex", "com")]
)
def test_off_diagonal_inertia_of_a_file_has_the_sign_of_the_tensor(write, program, reference):
    """Both programs read I_xy = −∫xy dm, not products of inertia."""
    points = np.array([(0.4, 0.3, -0.1), (-0.2, 0.1, 0.4), (0.1, -0.5, 0.2), (-0.1, 0.2, -0.3)])
    points = np.vstack([points, -points.sum(axis=0)])  # the centre of mass is the origin
    about = points
    if reference == "joint":
        about = points + CENTER
    tensor = inertia_matrix(about)
    entries = (*np.diag(tensor), tensor[0, 1], tensor[0, 2], tensor[1, 2])
    if program == "caspr":
        path = write(bodies=bodies(ref=reference, inertia=entries), cables=cables())
    else:
        path = write(wcrfx=wirex(inertia=entries, center=CENTER))
    expected = inertia_matrix(points @ Z_DOWN)
    assert np.abs(expected[np.triu_indices(3, 1)]).min() > 0.02
    assert_allclose(import_robot(path).robot.inertia_tensor, expected, atol=1e-9)


def test_inertia_about_the_joint_is_moved_to_the_centre_of_mass(write):
    robot = import_robot(write(bodies=bodies(ref="joint"), cables=cables())).robot
    x, y, z = CENTER
    assert robot.inertia_tensor[0, 0] == pytest.approx(1 - 5 * (y**2 + z**2))
    assert robot.inertia_tensor[0, 1] == pytest.approx(-(0.1 + 5 * x * y))


def test_winch_and_cable_of_a_wirex_file_reach_the_robot(write):
    imported = import_robot(write(wcrfx=wirex()))
    robot = imported.robot
    drum = robot.transmission
    assert (robot.motors.stall_torque, robot.motors.free_speed) == (36.0, 30.0)
    assert (drum.pulley_radius, drum.pulley_inertia, robot.cable_density) == (0.05, 0.009, 0.02)
    for name in ("center_of_mass", "motors.stall_torque"):
        assert "WireX's default" in imported.sources[name]
    notes = " ".join(imported.notes)
    assert "EA = 3142 N" in notes
    assert "swivel pulleys of 0.1 m" in notes


@pytest.mark.parametrize("angle", [0.0, 0.2])
@pytest.mark.parametrize(
    ("joint", "axes", "about", "plane"),
    [
        ("PLANAR_XZ", (0, 2), (0, 1, 0), "vertical"),
        ("PLANAR_YZ", (1, 2), (1, 0, 0), "vertical"),
        ("PLANAR_XY", (0, 1), (0, 0, 1), "horizontal"),
        ("P_XZ", (0, 2), (0, 0, 0), "vertical"),
        ("P_XY", (0, 1), (0, 0, 0), "horizontal"),
    ],
)
def test_planar_joints_keep_lengths(write, joint, axes, about, plane, angle):
    base, body = np.zeros((2, 4, 3))
    base[:, axes] = SQUARE
    body[:, axes] = SQUARE * (0.1, -0.1)
    turns = joint.startswith("PLANAR")
    sense = -1 if joint == "PLANAR_YZ" else 1
    text = bodies(joint, "0.1 0.2 0.1" if turns else "0.1 0.2").replace("0 0 0.1", "0 0 0")
    robot = import_robot(write(cables=cables(base, body, "joint"), bodies=text)).robot
    assert (robot.plane, robot.point_mass) == (plane, not turns)
    assert not turns or robot.home[2] == sense * 0.1
    position = np.zeros(3)
    position[list(axes)] = 0.3, -0.1
    arms = Rotation.from_rotvec(angle * np.array(about)).apply(body)
    lengths = np.linalg.norm(base - position - arms, axis=1)
    pose = [0.3, 0.1 if plane == "vertical" else -0.1, *([sense * angle] if turns else [])]
    assert_allclose(textbook.cable_lengths(robot, pose), lengths, atol=1e-12)


SQUARE = np.array([(-1, 1), (1, 1), (1, -1), (-1, -1)])


@pytest.mark.parametrize(
    ("texts", "message"),
    [
        (
            {"bodies": bodies(count=2), "cables": cables()},
            "it has 2 bodies. Only robots with one rigid body",
        ),
        (
            {"bodies": bodies("R_X", "0"), "cables": cables()},
            "its joint is R_X. Only SPATIAL_EULER_XYZ",
        ),
        ({"bodies": bodies()}, "toy_cables.xml is missing beside it"),
        (
            {
                "bodies": bodies(),
                "cables": cables(tag="cable_passive_linear_spring"),
            },
            "'c0' is a passive spring",
        ),
        (
            {
                "bodies": bodies(),
                "cables": cables(fixed="screw_base_rotating_pulley"),
            },
            "which has no model",
        ),
        (
            {"bodies": bodies(start="0 0 nan 0 0 0"), "cables": cables()},
            "q_initial must be 6 finite numbers",
        ),
        (
            {"bodies": bodies(ref="hand"), "cables": cables()},
            "<inertia> has ref 'hand'",
        ),
        (
            {"bodies": "<!DOCTYPE a [<!ENTITY b 'c'>]><a>&b;</a>"},
            "it defines XML entities. Remove them",
        ),
        ({"bodies": "<robot/>"}, "its root is <robot>. CASPR has"),
        ({"bodies": "no"}, "it is not valid XML"),
        ({"wcrfx": wirex("2T")}, "its motion pattern is '2T'"),
        (
            {"wcrfx": wirex().replace('mass="5"', 'mass="?"')},
            "<platform> needs a number mass",
        ),
        ({"wcrfx": "<models/>"}, "<models> has no <robot>"),
        (
            {
                "bodies": bodies(),
                "cables": cables([(-2, 0, 2), (2, 0, 2)], [(-1, 0, 0), (1, 0, 0)]),
            },
            "the base anchors of the 2 cables span no workspace: add cables",
        ),
    ],
)
def test_file_without_a_model_is_refused_in_one_sentence(write, texts, message):
    with pytest.raises(ValueError, match=rf"^cannot import '.*toy.*': .*{message}"):
        import_robot(write(**texts))


@pytest.mark.parametrize(
    ("encoding", "message"),
    [("utf-8-sig", "its motion pattern is '2T'"), ("utf-16", "save it as UTF-8")],
)
def test_file_is_utf_8_with_or_without_a_mark(write, encoding, message):
    path = write(wcrfx=wirex("2T"))
    path.write_text(path.read_text(), encoding=encoding)
    with pytest.raises(ValueError, match=message):
        import_robot(path)


def test_robot_that_no_pose_holds_is_written_with_a_question(write, tmp_path):
    """The importer's own pose was refused, with no file in which to correct its cause."""
    center = " ".join(map(str, CENTER))
    base = [(x + z / 10, y, 2.0) for x, y, z in BASE]
    text = cables(base, [(x, y, 0.1) for x, y, _ in BODY], "joint")
    path = write(bodies=bodies().replace(center, "1 0 0"), cables=text)
    imported = import_robot(path)
    assert "the centre of mass is 1 m from the middle of the platform" in imported.question
    (tmp_path / "toy.toml").write_text(imported.to_toml(), encoding="utf-8")
    with pytest.raises(ValueError, match="no positive tensions hold home_pose"):
        load_robot(tmp_path / "toy.toml")


def test_cable_set_is_chosen_by_name(write):
    path = write(bodies=bodies(), cables=cables())
    with pytest.raises(ValueError, match="cable set 'two' has no cables"):
        import_robot(path, cable_set="two")
    with pytest.raises(ValueError, match="unknown cable set 'three'; choose one of one, two"):
        import_robot(path, cable_set="three")
