"""Models: composition with `+`, and the TOML file with its error messages."""

import math
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil.errors import ConfigError
from hil.models import catalogue
from hil.models.files import read_model, write_model
from hil.models.model import Band, RobotModel, Use, Value, base_model
from hil.record.recording import RobotSource

AXIS = RobotSource("single-axis")
BASE = base_model(AXIS)
HEAD = 'schema = "hil.model/1"\n[robot]\npreset = "single-axis"\n'
COULOMB = '[[effects]]\ntype = "coulomb"\n'
PLUGIN = """
from hil.models.effect import Doc, Effect, Param


class Creep(Effect):
    name, family = "cable-creep", "friction"
    doc = Doc("tau = c q", signature="slow", shown_by="rest", source="a book")
    params = (Param("c", "{F}/{x}", "creep"),)

    def columns(self, motion, j, shape):
        return motion.q[:, j : j + 1].copy()


EFFECTS = (Creep(),)
"""


@pytest.fixture(autouse=True)
def own_catalogue(monkeypatch: pytest.MonkeyPatch) -> None:
    """Effects that a test's plugin adds are gone after it."""
    monkeypatch.setattr(catalogue, "_table", dict(catalogue.table()))


# --- composition ----------------------------------------------------------------------------


def test_base_model_is_the_contract_s_with_an_offset_a_joint() -> None:
    assert BASE.names() == ("rigid-body", "armature", "coulomb", "viscous", "torque-offset")
    assert all(use.joints == ("*",) for use in BASE.effects)


def test_plus_makes_a_new_model_and_leaves_the_old_one() -> None:
    more = BASE + "stribeck"
    assert more.names() == (*BASE.names(), "stribeck")
    assert "stribeck" not in BASE.names()
    assert (more - "stribeck") == BASE


def test_plus_takes_an_effect_on_some_joints() -> None:
    model = BASE + Use("stribeck", ("joint2",)) + Use("stribeck", ("joint3",))
    assert model.names().count("stribeck") == 1
    assert [u.joints for u in model.effects if u.type == "stribeck"] == [("joint2",), ("joint3",)]
    assert (model - "stribeck") == BASE


def test_minus_takes_an_effect_off_some_joints_and_leaves_it_on_the_others() -> None:
    every = ("joint1", "joint2", "joint3")
    model = BASE + Use("stribeck", ("joint1", "joint2")) + Use("stribeck", ("joint3",))
    less = model - Use("stribeck", "joint1")
    assert [u.joints for u in less.effects if u.type == "stribeck"] == [("joint2",), ("joint3",)]
    assert less - Use("stribeck", ("joint2", "joint3")) == BASE
    # an effect on all joints stays on the others, with the values that are theirs
    known = {f"j{k}.spring.k": Value(float(k)) for k in (1, 2, 3)}
    whole = BASE + Use("spring", values=known)
    (left,) = [u for u in whole.without("spring", "joint2", every).effects if u.type == "spring"]
    assert left.joints == ("joint1", "joint3") and set(left.values) == {
        "j1.spring.k",
        "j3.spring.k",
    }
    with pytest.raises(ConfigError, match=r"model\.without\('spring', \['joint2'\], every="):
        whole - Use("spring", "joint2")
    with pytest.raises(ConfigError, match="unknown joint of 'stribeck' 'joint4'"):
        model.without("stribeck", "joint4", every)
    with pytest.raises(ConfigError, match="'rigid-body' is of the whole robot"):
        model.without("rigid-body", "joint1", every)


@pytest.mark.parametrize(
    ("first", "second"), [(("*",), ("*",)), (("*",), ("a",)), (("a", "b"), ("b", "c"))]
)
def test_the_same_effect_twice_on_a_joint_clashes(
    first: tuple[str, ...], second: tuple[str, ...]
) -> None:
    with pytest.raises(ConfigError, match=r"already has 'spring' on .*remove it first"):
        BASE + Use("spring", first) + Use("spring", second)


def test_unknown_names_come_with_the_nearest() -> None:
    with pytest.raises(ConfigError, match=r"unknown effect 'stribek'\. Did you mean 'stribeck'\?"):
        BASE + "stribek"
    with pytest.raises(
        ConfigError, match=r"unknown effect of this model 'viscus'\. Did you mean 'viscous'"
    ):
        BASE - "viscus"
    with pytest.raises(
        ConfigError, match=r"effect 'spring': unknown joint 'joint7'.*joint1, joint2"
    ):
        (BASE + Use("spring", ("joint7",))).check_joints(("joint1", "joint2"))
    (BASE + Use("spring", ("joint1",))).check_joints(("joint1", "joint2"))


def test_values_are_gathered_by_full_name() -> None:
    use = Use("spring", values={"j1.spring.k": Value(2.0, 0.1)})
    assert (BASE + use).values() == {"j1.spring.k": Value(2.0, 0.1)}


# --- round trip -----------------------------------------------------------------------------


def same(a: Value, b: Value) -> bool:
    nan = math.isnan(a.stderr) and math.isnan(b.stderr)
    return replace(a, stderr=0.0) == replace(b, stderr=0.0) and (nan or a.stderr == b.stderr)


def assert_same(a: RobotModel, b: RobotModel) -> None:
    assert replace(a, effects=(), urdf_path="") == replace(b, effects=(), urdf_path="")
    for x, y in zip(a.effects, b.effects, strict=True):
        assert (x.type, x.joints, x.options) == (y.type, y.joints, y.options)
        assert x.values.keys() == y.values.keys()
        assert all(same(x.values[k], y.values[k]) for k in x.values)


def test_round_trip_of_everything(tmp_path: Path, agreed) -> None:
    (tmp_path / "creep.py").write_text(PLUGIN)
    agreed(tmp_path / "creep.py")
    (tmp_path / "m.toml").write_text(f'plugins = ["./creep.py"]\n{HEAD}{COULOMB}')
    model = read_model(tmp_path / "m.toml")
    values = {
        "j1.spring.k": Value(2.5, 0.1, "N m/rad", -1.0, math.inf, source="fit of run"),
        "j1.spring.t0": Value(-1e-17, identifiable=False),
    }
    bound = {"j1.cable-creep.c[run 1.b]": Value(0.0, 0.5, "N", 0.0, 3.0, at_bound=True)}
    model = replace(model, arm="follower", explains="external", band=Band(60.0, 20.0))
    model += Use("spring", ("joint1", "joint2"), {"fixed": True}, values)
    model += Use("cable-creep", ("*",), {"per_run": True, "fixed_shape": False}, bound)
    write_model(model, tmp_path / "m2.toml")
    assert_same(read_model(tmp_path / "m2.toml"), model)


def test_plugin_is_written_relative_to_the_model(tmp_path: Path, agreed) -> None:
    (tmp_path / "a").mkdir()
    (tmp_path / "creep.py").write_text(PLUGIN)
    agreed(tmp_path / "creep.py")
    (tmp_path / "m.toml").write_text(f'plugins = ["creep.py"]\n{HEAD}{COULOMB}')
    write_model(read_model(tmp_path / "m.toml"), tmp_path / "a" / "m.toml")
    assert 'plugins = ["../creep.py"]' in (tmp_path / "a" / "m.toml").read_text()
    assert read_model(tmp_path / "a" / "m.toml").plugins == (str(tmp_path / "creep.py"),)


def test_urdf_is_written_beside_the_model(tmp_path: Path) -> None:
    model = base_model(RobotSource("", "<robot name='grün'/>", "tool"))
    write_model(model, tmp_path / "arm.toml")
    assert (tmp_path / "arm.urdf").read_text(encoding="utf-8") == model.robot.urdf
    assert_same(read_model(tmp_path / "arm.toml"), model)


def test_the_same_urdf_beside_a_model_is_no_obstacle(tmp_path: Path) -> None:
    model = base_model(RobotSource("", "<robot name='a'>\n</robot>"))
    (tmp_path / "arm.urdf").write_bytes(b"<robot name='a'>\r\n</robot>")
    for _ in range(2):
        write_model(model, tmp_path / "arm.toml")
    assert (tmp_path / "arm.urdf").read_bytes() == b"<robot name='a'>\r\n</robot>"
    assert_same(read_model(tmp_path / "arm.toml"), model)


@pytest.mark.parametrize("there", ["<robot name='mine'/>", "", None])
def test_another_file_at_the_urdf_s_place_stays(tmp_path: Path, there: str | None) -> None:
    place, model = tmp_path / "arm.urdf", base_model(RobotSource("", "<robot name='a'/>"))
    if there is None:
        place.mkdir()
    else:
        place.write_text(there)
    with pytest.raises(ConfigError, match=r"goes into .*arm\.urdf, which holds something else"):
        write_model(model, tmp_path / "arm.toml")
    assert not (tmp_path / "arm.toml").exists()
    assert place.is_dir() if there is None else place.read_text() == there


@pytest.mark.parametrize(
    ("name", "there"),
    [
        ("run.csv", b"t,q1,tau1\n0,0,0\n"),
        ("new.csv", None),
        ("arm.urdf", b"<robot/>"),
        ("mine.toml", b"x = 1\n"),
        ("session.toml", b"\x89MCAP0\r\n"),
        ("rig.toml", b'schema = "hil.rig/1"\n'),
    ],
)
def test_a_model_is_written_over_no_file_of_another_kind(
    tmp_path: Path, name: str, there: bytes | None
) -> None:
    place = tmp_path / name
    if there is not None:
        place.write_bytes(there)
    expected = "a file is there that is not a model" if name.endswith("toml") else r"ends in \.toml"
    with pytest.raises(ConfigError, match=expected) as caught:
        write_model(base_model(RobotSource("", "<robot name='a'/>")), place)
    assert "\n" not in str(caught.value)
    assert (place.read_bytes() if there is not None else place.exists()) == (there or False)


def test_a_model_replaces_an_older_model_and_an_empty_file(tmp_path: Path) -> None:
    (tmp_path / "m.toml").touch()
    for model in (BASE, BASE + "spring"):
        write_model(model, tmp_path / "m.toml")
        assert_same(read_model(tmp_path / "m.toml"), model)
    with pytest.raises(ConfigError, match="it is a folder"):
        (tmp_path / "f.toml").mkdir()
        write_model(BASE, tmp_path / "f.toml")


@given(
    text=st.text(st.characters(codec="utf-8"), max_size=20),
    number=st.floats(allow_nan=False),
    # a zero byte in a name is refused
    key=st.text(st.characters(codec="utf-8", exclude_characters="\0"), min_size=1, max_size=20),
)
def test_any_text_and_number_survive(
    tmp_path_factory: pytest.TempPathFactory, text: str, number: float, key: str
) -> None:
    path = tmp_path_factory.mktemp("m") / "m.toml"
    use = Use("spring", (key,), {}, {key: Value(number, source=text, unit=text)})
    model = RobotModel(RobotSource("single-axis", tip=text), (use,), arm=text)
    write_model(model, path)
    back = read_model(path)
    joints = ("*",) if key == "all" else (key,)
    assert_same(back, replace(model, effects=(replace(use, joints=joints),)))


def test_a_plain_number_is_a_value(tmp_path: Path) -> None:
    path = tmp_path / "m.toml"
    path.write_text(HEAD + COULOMB + '[effects.parameters]\n"j1.coulomb.fc" = 2\n')
    value = read_model(path).values()["j1.coulomb.fc"]
    assert value.value == 2.0 and math.isnan(value.stderr) and value.upper == math.inf


def test_a_file_without_effects_is_the_base_model(tmp_path: Path) -> None:
    path = tmp_path / "m.toml"
    path.write_text('schema = "hil.model/1"\n')
    assert read_model(path).effects == base_model(RobotSource("")).effects


def test_one_joint_may_be_written_as_text(tmp_path: Path) -> None:
    path = tmp_path / "m.toml"
    path.write_text(HEAD + COULOMB + 'joints = "joint2"\n')
    assert read_model(path).effects[0].joints == ("joint2",)


# --- messages -------------------------------------------------------------------------------

VALUE = HEAD + COULOMB + "[effects.parameters]\n"
BAD = {
    "schema": (
        HEAD.replace("model/1", "rig/1"),
        r"schema is 'hil.rig/1', expected 'hil.model/1'",
    ),
    "no-schema": (COULOMB, "schema is None"),
    "not-toml": ("schema = ", "cannot be read"),
    "top-key": ("effect = 1\n" + HEAD, "unknown key in the model 'effect'. Did you mean 'effects'"),
    "robot-key": (HEAD + "urfd = 1\n" + COULOMB, "unknown key in .robot. 'urfd'.*'urdf'"),
    "robot": ('robot = "arm"\nschema = "hil.model/1"\n' + COULOMB, "must be a table with urdf"),
    "both": (HEAD + 'urdf = "a.urdf"\n' + COULOMB, "both urdf and preset; keep one"),
    "urdf": (HEAD.replace("preset", "urdf") + COULOMB, "urdf = 'single-axis': no such file"),
    "explains": (HEAD + 'explains = "motors"\n' + COULOMB, "'motors'. Did you mean 'motor'"),
    "signal": ("signal = 3\n" + HEAD + COULOMB, "must be a table with some of position_hz"),
    "signal-key": (HEAD + COULOMB + "[signal]\nefort_hz = 3\n", "'efort_hz'. Did you mean"),
    "signal-text": (HEAD + COULOMB + '[signal]\neffort_hz = "x"\n', "effort_hz = 'x': expected a"),
    "signal-sign": (HEAD + COULOMB + "[signal]\neffort_hz = -2\n", "= -2: expected a frequency"),
    "none": ("effects = []\n" + HEAD, r"leave effects out altogether for the base .*rigid-body"),
    "table": (HEAD + "[effects]\ntype = 'coulomb'\n", r"write one \[\[effects\]\] table"),
    "external": (HEAD + 'explains = "external"\n', "needs its law of contact"),
    "no-type": (HEAD + "[[effects]]\njoints = 'all'\n", "every .* needs type"),
    "text": ("effects = ['coulomb']\n" + HEAD, "every .* needs type"),
    "effect": (HEAD + '[[effects]]\ntype = "culomb"\n', "'culomb'. Did you mean 'coulomb'"),
    "option": (HEAD + COULOMB + "perrun = true\n", "'perrun'. Did you mean 'per_run'"),
    "option-text": (HEAD + COULOMB + 'fixed = "no"\n', "fixed = 'no': expected true or false"),
    "joints": (HEAD + COULOMB + "joints = 2\n", "joints = 2: expected a list of texts"),
    "joint-number": (HEAD + COULOMB + "joints = [2]\n", r"joints = \[2\]: expected a list"),
    "no-joints": (HEAD + COULOMB + "joints = []\n", r"joints = \[\]: name each joint once"),
    "joint-twice": (HEAD + COULOMB + 'joints = ["a", "a"]\n', "name each joint once"),
    "clash": (HEAD + COULOMB + COULOMB, "already has 'coulomb' on all joints"),
    "parameters": (HEAD + COULOMB + "parameters = 3\n", "must be a table of names"),
    "value": (VALUE + '"fc" = "x"\n', "parameter 'fc' = 'x': expected a number"),
    "boolean": (VALUE + '"fc" = true\n', "parameter 'fc' = True: expected a number"),
    "no-value": (VALUE + '"fc" = { unit = "N" }\n', r"expected a number or { value = ... }"),
    "text-value": (VALUE + '"fc" = { value = "x" }\n', "value = 'x': expected a number"),
    "value-key": (VALUE + '"fc" = { value = 1, bound = [0, 1] }\n', "'bound'. Did you mean"),
    "bounds": (VALUE + '"fc" = { value = 1, bounds = 0 }\n', r"bounds = 0: expected \[lower"),
    "bound": (VALUE + '"fc" = { value = 1, bounds = [0, "x"] }\n', "bounds = 'x': expected a"),
    "plugins": ('plugins = "a.py"\n' + HEAD + COULOMB, "plugins = 'a.py': expected a list"),
    "zero byte": ('plugins = ["a\\u0000"]\n' + HEAD + COULOMB, "expected a list of texts"),
    "plugin": ('plugins = ["a.py"]\n' + HEAD + COULOMB, r"plugin .*a\.py: no such Python file"),
}


@pytest.mark.parametrize("case", BAD)
def test_a_bad_file_is_named_with_one_clear_message(case: str, tmp_path: Path) -> None:
    text, message = BAD[case]
    path = tmp_path / "bad.toml"
    path.write_text(text)
    with pytest.raises(ConfigError, match=rf"model .*bad\.toml.*{message}") as caught:
        read_model(path)
    assert caught.value.exit_code == 2
    assert "\n" not in str(caught.value)


def test_missing_and_unreadable_files_are_named(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"none.toml: no such file"):
        read_model(tmp_path / "none.toml")
    with pytest.raises(ConfigError, match="cannot be read"):
        read_model(tmp_path)
    (tmp_path / "latin.toml").write_bytes(b'schema = "\xe9"')
    with pytest.raises(ConfigError, match="cannot be read"):
        read_model(tmp_path / "latin.toml")


def test_a_robots_description_in_the_place_of_a_model_is_told(tmp_path):
    (tmp_path / "arm.urdf").write_text("<?xml version='1.0'?>\n<robot name='arm'/>\n")
    with pytest.raises(ConfigError, match="is a robot's description; give it to 'hil import"):
        read_model(tmp_path / "arm.urdf")


def test_writing_into_no_folder_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"folder .* does not exist"):
        write_model(BASE, tmp_path / "none" / "m.toml")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("def", "does not run: .*SyntaxError"),
        ("1 / 0", "does not run: ZeroDivisionError"),
        ("x = 1", r"has no EFFECTS = \(MyEffect\(\),\)"),
        (PLUGIN.replace("(Creep(),)", "Creep()"), r"has no EFFECTS = \(MyEffect\(\),\)"),
        (
            PLUGIN.replace("(Creep(),)", "(Creep,)"),
            "EFFECTS of .* holds .*Creep.* not an Effect instance",
        ),
        (PLUGIN.replace('"cable-creep"', '"spring"'), "'spring' .* already defined in hil.models"),
    ],
)
def test_a_bad_plugin_is_named(text: str, message: str, tmp_path: Path, agreed) -> None:
    (tmp_path / "own.py").write_text(text)
    agreed(tmp_path / "own.py")
    (tmp_path / "m.toml").write_text(f'plugins = ["own.py"]\n{HEAD}{COULOMB}')
    with pytest.raises(ConfigError, match=message):
        read_model(tmp_path / "m.toml")


def test_a_value_that_an_effect_does_not_have_is_refused_with_those_it_has(tmp_path):
    text = (
        'schema = "hil.model/1"\n[robot]\n[[effects]]\ntype = "elastic-transmission"\n'
        'joints = ["a"]\n[effects.parameters]\n"j1.elastic-transmission.f" = 7.0\n'
    )
    file = tmp_path / "old.toml"
    file.write_text(text, "utf-8")
    with pytest.raises(ConfigError, match=r"has no value 'f' .*it has a, k, zeta, fl, i;"):
        read_model(file)
