"""Every mistake in a robot file is told in one line: file, line, what is wrong, what to do."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from runtime.cli.main import USAGE, main
from runtime.settings import ROBOTS, SettingsError, find_robot_file, load_path, load_robot
from runtime.toml_lines import KeyPath, line_of, locate

BODY = """<mujoco>
  <default><default class="bent"><joint range="-5 130"/></default></default>
  <worldbody>
    <body name="upper_arm" childclass="bent">
      <geom name="elbow_pulley" type="cylinder" size=".02 .03"/>
      <site name="elbow_front"/>
      <body name="forearm"><joint name="elbow"/><joint name="wrist" range="-60 60"/></body>
    </body>
  </worldbody>
  <tendon>
    <spatial name="triceps"/>
    <spatial name="biceps_1"/>
    <spatial name="biceps_2"/>
  </tendon>
</mujoco>
"""

ROBOT = """\
# line 1
[robot]
name = "elbow"
body = "elbow.xml"

[[chain]]
name = "arm"
baud = 3_000_000
rate_hz = 200.0

[[joint]]
name = "elbow"
chain = "arm"
id = 100

[[muscle]]
name = "triceps"
chain = "arm"
id = 2

[[muscle]]
name = "biceps_1"
chain = "arm"
id = 3

[[spare]]
name = "biceps_3"
chain = "arm"
[spare.path]
attachment = { link = "upper_arm", position_m = [0.022, 0.012, -0.05] }
direction = [0.0, 0.0, -1.0]
relays = [
    { wrap = "elbow_pulley", side = "elbow_front" },
    { link = "forearm", position_m = [0.012, 0.008, -0.06] },
]

[[task]]
name = "sweep"
targets_deg = [
    [15], [30],
    [120],
]

[control]
tension_floor_n = 8.0

[growth]
n_new = 7
"""

MISTAKES = [
    # what stands there, what stands there instead, line, words
    # TOML itself
    ('name = "elbow"', 'name = "elbow', 3, "not valid TOML"),
    ("[[chain]]", "[chain", 6, "not valid TOML"),
    ("id = 2", "id = 2\nid = 2", 20, "not valid TOML"),
    ("n_new = 7", "n_new = [7", 49, "not valid TOML"),
    # keys
    ("id = 3\n", "", 21, "muscle 'biceps_1' lacks id"),
    ('body = "elbow.xml"', "", 2, "[robot] lacks body"),
    ("[robot]", "[other]", 2, "the file has no key 'other'; there is chain, control, growth"),
    ("[[joint]]", "[joints]", 11, "the file has no key 'joints'; did you mean 'joint'?"),
    ("[[chain]]", "[[chains]]", 6, "did you mean 'chain'?"),
    ("id = 3", "idd = 3", 24, "muscle 'biceps_1' has no key 'idd'; did you mean 'id'?"),
    (
        "tension_floor_n",
        "tension_flor_n",
        45,
        "[control] has no key 'tension_flor_n'; did you mean",
    ),
    ("side =", "sides =", 33, "path, relays number 1 has no key 'sides'; did you mean 'side'?"),
    # types
    ("id = 3", 'id = "3"', 24, "muscle 'biceps_1': id has to be a whole number, found '3'"),
    ("id = 3", "id = 3.5", 24, "found 3.5, a number"),
    ("200.0", '"fast"', 9, "chain 'arm': rate_hz has to be a number, found 'fast', a string"),
    ("[120]", '["x"]', 41, "element 1 has to be a number, found 'x'"),
    ("[15], [30]", "15, 30", 40, "element 1 has to be an array, found 15"),
    ("[0.0, 0.0, -1.0]", "[0.0, -1.0]", 31, "direction has to be 3 numbers, found 2 of them"),
    ("[[joint]]", "[joint]", 11, "'joint' has to be an array; write [[joint]]"),
    ("[control]", "[[control]]", 44, "'control' has to be a table; write [control]"),
    ('name = "elbow"\nbody', "name = 2020-01-01\nbody", 3, "name has to be a string in quotes"),
    # names
    ('name = "elbow"\nbody', 'name = "a\\nb"\nbody', 3, r"robot name 'a\nb' cannot be"),
    ('name = "elbow"\nbody', 'name = "my elbow"\nbody', 3, "robot name 'my elbow' cannot be"),
    ('name = "elbow"\nbody', 'name = "a/b"\nbody', 3, "use letters, digits"),
    ('name = "elbow"\nbody', 'name = "a*"\nbody', 3, "robot name 'a*' cannot be"),
    ('name = "elbow"\nbody', 'name = ""\nbody', 3, "robot name '' cannot be"),
    ('name = "arm"', 'name = "arm/left"', 7, "chain name 'arm/left' cannot be"),
    ('name = "biceps_1"', 'name = "triceps"', 22, "a second muscle is named 'triceps'"),
    ('name = "biceps_3"', 'name = "triceps"', 27, "a second muscle is named 'triceps'"),
    ('name = "sweep"', 'name = "park"', 38, "kept for the request of that name"),
    ('"arm"\nid = 3', '"amr"\nid = 3', 23, "which no [[chain]] names; did you mean 'arm'?"),
    ('"arm"\nid = 100', '"leg"\nid = 100', 13, "joint 'elbow' is on chain 'leg'"),
    ('"arm"\n[spare', '"leg"\n[spare', 28, "spare 'biceps_3' is on chain 'leg'"),
    # ids
    (
        "id = 3",
        "id = 2",
        24,
        "muscle 'biceps_1' has id 2, which muscle 'triceps' on chain 'arm' has",
    ),
    ("id = 3", "id = 100", 24, "which joint 'elbow' on chain 'arm' has already; 3 is free"),
    ("id = 3", "id = 1", 24, "id 1 is kept for fresh modules; 3 is free"),
    ("id = 3", "id = 253", 24, "id 253 is out of range; use 2 to 252"),
    ("id = 3", "id = -4", 24, "id -4 is out of range"),
    ("rate_hz = 200.0", "max_modules = 2", 9, "chain 'arm' has 3 modules, max_modules is 2"),
    # numbers
    ("200.0", "0", 9, "chain 'arm': rate_hz has to be above 0 and at most 1000, found 0"),
    ("200.0", "-200.0", 9, "found -200"),
    ("200.0", "nan", 9, "found nan"),
    ("3_000_000", "3_000", 8, "no module speaks at 3000 baud; use one of 9_600"),
    ("rate_hz = 200.0", "watchdog_ms = 90", 9, "watchdog_ms counts in steps of 20"),
    ("rate_hz = 200.0", 'link = "tty:"', 9, "link 'tty:' cannot be; use sim: or serial://"),
    ("[growth]", "[module]\ntension_limit_n = 0\n[growth]", 48, "[module]: tension_limit_n has to"),
    ("[growth]", "[module]\ntension_limit_n = 900\n[growth]", 48, "at most 400, found 900"),
    ("floor_n = 8.0", "floor_n = -8.0", 45, "tension_floor_n has to be above 0, found -8"),
    ("floor_n = 8.0", "floor_n = 130", 45, "has to be below tension_ceiling_n 120"),
    ("floor_n = 8.0", "ceiling_n = 500", 45, "above the modules' tension_limit_n 150; lower it"),
    ("n_new = 7", "n_new = 0", 48, "[growth]: n_new has to be above 0, found 0"),
    ("n_new = 7", 'method = "v"', 48, "no method 'v'; use one of i, ii, iii"),
    ("n_new = 7", "bias_min_n = 70", 47, "have to stand in this order"),
    # the page
    ("[growth]", "[web]\nport = 0\n[growth]", 48, "[web]: port has to be above 0 and at most"),
    ("[growth]", "[web]\nport = 70000\n[growth]", 48, "at most 65535, found 70000"),
    ("[growth]", "[web]\naddress = 'arm.lab'\n[growth]", 48, "'arm.lab' is no IP address; use"),
    ("[growth]", "[web]\nkey = 'elbow.xml'\n[growth]", 48, "certificate and key go together"),
    # the body
    ("elbow.xml", "elbov.xml", 4, "elbov.xml does not exist; did you mean"),
    ("elbow.xml", "broken.xml", 4, "broken.xml is not XML: "),
    ("elbow.xml", "page.xml", 4, "is not a MuJoCo body: its outermost element is <html>"),
    ("elbow.xml", "stiff.xml", 4, "stiff.xml has no spatial tendon"),
    ('name = "elbow"\nchain', 'name = "elbo"\nchain', 12, "no joint 'elbo' in elbow.xml; did you"),
    (
        '"biceps_1"',
        '"bicep_1"',
        22,
        "muscle 'bicep_1' has no tendon in elbow.xml; did you mean 'biceps_1'?",
    ),
    # the spare's path
    ('"upper_arm"', '"uper_arm"', 30, "attachment: no body 'uper_arm' in elbow.xml; did you mean"),
    ('"elbow_pulley"', '"pulley"', 33, "relay 1: no geom 'pulley' in elbow.xml"),
    ('"elbow_front"', '"elbow_frnt"', 33, "no site 'elbow_frnt' in elbow.xml; did you mean"),
    ('{ link = "forearm",', '{ link = "hand",', 34, "relay 2: no body 'hand' in elbow.xml"),
    ('{ link = "forearm",', '{ wrap = "elbow_pulley",', 34, "either link and position_m, or wrap"),
    ('{ link = "upper_arm",', "{", 30, "attachment needs either link and position_m, or wrap"),
    ("[0.022, 0.012, -0.05]", "[22, 12, -50]", 30, "position_m is in metres"),
    ("[0.0, 0.0, -1.0]", "[0, 0, 0]", 31, "direction has no direction"),
    # tasks
    ("[120]", "[120, 30]", 41, "task 'sweep', target 3 has 2 angles, there are 1 joints: elbow"),
    ("[120]", "[170]", 41, "joint 'elbow' at 170 deg is outside its range in elbow.xml, -5 to 130"),
    ("id = 100", "id = 100\nrest_deg = -20", 15, "joint 'elbow': rest_deg -20 deg is outside"),
    ("[\n    [15], [30],\n    [120],\n]", "[]", 39, "task 'sweep' has no targets"),
]


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "elbow.xml").write_text(BODY)
    (tmp_path / "broken.xml").write_text(BODY.replace("</tendon>", ""))
    (tmp_path / "page.xml").write_text("<html/>")
    (tmp_path / "stiff.xml").write_text(re.sub(r"<spatial.*", "", BODY))
    return tmp_path


@pytest.mark.parametrize(("old", "new", "line", "words"), MISTAKES)
def test_mistake_names_file_line_and_remedy(
    folder: Path, old: str, new: str, line: int, words: str
) -> None:
    assert old in ROBOT
    (folder / "robot.toml").write_text(ROBOT.replace(old, new, 1))
    with pytest.raises(SettingsError) as caught:
        load_robot("robot.toml")
    text = str(caught.value)
    assert text.startswith(f"robot.toml:{line}: "), text
    assert words in text
    assert "\n" not in text


@pytest.mark.parametrize(("old", "new"), [row[:2] for row in MISTAKES])
def test_command_line_tells_it_without_a_traceback(
    folder: Path, capsys: pytest.CaptureFixture[str], old: str, new: str
) -> None:
    (folder / "robot.toml").write_text(ROBOT.replace(old, new, 1))
    assert main(["up", "robot.toml"]) == USAGE
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("myograft: robot.toml:")


CUP = """
[[payload]]
name = "forearm"  # stands for a thing of the body file
mass_kg = 0.3
link = "upper_arm"
position_m = [0, 0, 0]
"""


@pytest.mark.parametrize(
    ("task", "cup", "words"),
    [
        ("payload = 'forearm'\ngrasp_at = 1\nrelease_at = 3", CUP, ""),
        ("payload = 'cup'\ngrasp_at = 1\nrelease_at = 3", CUP, "carries 'cup', which no [[payload"),
        ("payload = 'forearm'\ngrasp_at = 3\nrelease_at = 3", CUP, "grasp_at < release_at <= 3"),
        ("payload = 'forearm'\ngrasp_at = 1\nrelease_at = 4", CUP, "go together"),
        ("payload = 'forearm'", CUP, "go together"),
        ("grasp_at = 1\nrelease_at = 3", CUP, "go together"),
        ("", CUP.replace("0.3", "0"), "payload 'forearm': mass_kg has to be above 0"),
        ("", CUP.replace("upper_arm", "uper_arm"), "no body 'uper_arm' in elbow.xml; did you"),
        ("", CUP.replace('"forearm"', '"cup"'), "payload 'cup': no body 'cup' in elbow.xml"),
        ("back = 'sweeep'", CUP, "by 'sweeep', which no [[task]] is; did you mean 'sweep'?"),
        ("", CUP + CUP, "a second payload is named 'forearm'"),
    ],
)
def test_payloads(folder: Path, task: str, cup: str, words: str) -> None:
    text = ROBOT.replace('name = "sweep"', f'name = "sweep"\n{task}') + cup
    (folder / "robot.toml").write_text(text)
    if not words:
        assert load_robot("robot.toml").payload[0].mass_kg == 0.3
        return
    with pytest.raises(SettingsError, match=re.escape(words)):
        load_robot("robot.toml")


def test_the_unedited_file_is_right(folder: Path) -> None:
    (folder / "robot.toml").write_text(ROBOT)
    robot = load_robot("robot.toml")
    assert robot.muscles == ("triceps", "biceps_1")
    assert robot.joints == ("elbow",)
    assert robot.body_file == folder / "elbow.xml"
    assert load_robot("robot.toml", name="left").name == "left"
    with pytest.raises(SettingsError, match=r"^robot name 'a b' cannot be"):
        load_robot("robot.toml", name="a b")


@pytest.mark.parametrize("file", sorted(ROBOTS.glob("*.toml")), ids=lambda file: file.stem)
def test_shipped_robot_is_right(file: Path) -> None:
    assert load_robot(str(file)).file == str(file.resolve())


def test_missing_file_suggests_one_that_ships(folder: Path) -> None:
    with pytest.raises(SettingsError, match=r"^elbo\.toml: no such file; did you mean .*elbow"):
        load_robot("elbo.toml")
    shipped = r"There is: elbow, musashi_arm, musashi_w, or the path of a robot file$"
    with pytest.raises(SettingsError, match=rf"^no robot 'elbo'; did you mean 'elbow'\? {shipped}"):
        load_robot("elbo")
    with pytest.raises(SettingsError, match=rf"^no robot 'spider'\. {shipped}"):
        load_robot("spider")


def test_unreadable_files(folder: Path) -> None:
    (folder / "latin.toml").write_bytes(b"# one\n# caf\xe9\n")
    with pytest.raises(SettingsError, match=r"^latin\.toml:2: not UTF-8"):
        load_robot("latin.toml")
    (folder / "dir.toml").mkdir()
    with pytest.raises(SettingsError, match=r"^dir\.toml: cannot be read: Is a directory"):
        load_robot("dir.toml")


def test_a_folder_named_like_a_robot_does_not_hide_it(folder: Path) -> None:
    (folder / "elbow").mkdir()
    assert find_robot_file("elbow") == ROBOTS / "elbow.toml"


def test_joint_range_in_radian_and_in_an_included_file(folder: Path) -> None:
    (folder / "elbow.xml").write_text(
        '<mujoco><compiler angle="radian"/><include file="rest.xml"/></mujoco>'
    )
    rest = BODY.replace("-5 130", "-0.1 1.0").replace("mujoco", "mujocoinclude")
    (folder / "rest.xml").write_text(rest)
    (folder / "robot.toml").write_text(ROBOT)
    with pytest.raises(SettingsError, match=r"-5\.72958 to 57\.2958 deg"):
        load_robot("robot.toml")


def test_body_that_includes_itself(folder: Path) -> None:
    (folder / "elbow.xml").write_text('<mujoco><include file="elbow.xml"/></mujoco>')
    (folder / "robot.toml").write_text(ROBOT)
    with pytest.raises(SettingsError, match=r"robot\.toml:4: .* which includes itself"):
        load_robot("robot.toml")


WORDS = "\" ''' [ ] [[ { } = # . , nan -1 true x [0] {} < /> \\ 1979-05-27 1e999 class='a' é"
SCRAPS = st.sampled_from([*WORDS.split(), "", "\n", "\0", "9" * 30])


@settings(max_examples=200, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(in_body=st.booleans(), where=st.floats(0, 1), size=st.integers(0, 30), scrap=SCRAPS)
def test_whatever_is_wrong_is_a_settings_error(
    folder: Path, in_body: bool, where: float, size: int, scrap: str
) -> None:
    files = {"elbow.xml": BODY, "robot.toml": ROBOT}
    name = "elbow.xml" if in_body else "robot.toml"
    at = round(where * len(files[name]))
    files[name] = files[name][:at] + scrap + files[name][at + size :]
    for file, text in files.items():
        (folder / file).write_text(text, encoding="utf-8")
    try:
        load_robot("robot.toml")
    except SettingsError as error:
        assert re.match(r"robot\.toml:\d+: .+", str(error))
        assert "\n" not in str(error)


PATH = ROBOT[ROBOT.index("attachment") : ROBOT.index("\n[[task]]")]


def test_path_of_its_own(folder: Path) -> None:
    (folder / "path.toml").write_text(PATH)
    (folder / "robot.toml").write_text(ROBOT)
    robot = load_robot("robot.toml")
    assert load_path("path.toml", robot) == robot.spare[0].path


@pytest.mark.parametrize(
    ("old", "new", "line", "words"),
    [
        ("direction", "directon", 2, "the file has no key 'directon'; did you mean 'direction'?"),
        ("[0.0, 0.0, -1.0]", '"down"', 2, "the file: direction has to be an array, found 'down'"),
        ('"forearm"', '"forarm"', 5, "relay 2: no body 'forarm' in elbow.xml; did you mean"),
        ("side", "link", 4, "relay 1 needs either link and position_m, or wrap"),
    ],
)
def test_mistake_in_a_path(folder: Path, old: str, new: str, line: int, words: str) -> None:
    (folder / "path.toml").write_text(PATH.replace(old, new, 1))
    (folder / "robot.toml").write_text(ROBOT)
    with pytest.raises(SettingsError) as caught:
        load_path("path.toml", load_robot("robot.toml"))
    assert str(caught.value).startswith(f"path.toml:{line}: ")
    assert words in str(caught.value)


TRICKY = '''\
top = 1 # [not.a.table]
"quoted key" = "a ] } # \\" b"
a.b = { c = [1, [2, 3]], "d.e" = \'}\' }  # comment
a.f = 1979-05-27 07:32:00
text = """
[[no]]
key = "x"
""""
raw = \'\'\'
# no comment
\'\'\'
[[row]]
x = []
[row.sub]
y = true
[[row]]
[[row.deep]]
z = [
  # a comment with ]
  {},
  "",
]
[ spaced . "out" ]
k = -1e3
'''


def test_locate_finds_every_key_that_tomllib_finds() -> None:
    def paths(value: object, path: KeyPath = ()) -> set[KeyPath]:
        parts = (
            value.items()
            if isinstance(value, dict)
            else enumerate(value)
            if isinstance(value, list)
            else ()
        )
        return {path}.union(*(paths(part, (*path, key)) for key, part in parts))

    for text in (TRICKY, ROBOT):
        assert set(locate(text)) | {()} == paths(tomllib.loads(text))
    lines = locate(TRICKY)
    assert lines["a", "b", "c", 1, 1] == 3
    assert lines["a", "f"] == 4
    assert lines["raw",] == 9
    assert lines["row", 0, "sub", "y"] == 15
    assert lines["row", 1, "deep", 0, "z", 0] == 20
    assert lines["row", 1, "deep", 0, "z", 1] == 21
    assert lines["spaced", "out", "k"] == 24
    assert line_of(lines, ("row", 1, "missing")) == 16
    assert line_of(lines, ("nowhere",)) == 1
