"""What a plugin imports from beside it runs as it was agreed to, and nothing else does."""

import json

import pytest

from hil.cli import main
from hil.errors import ConfigError
from hil.models import catalogue
from hil.trusted_code import local_modules

EFFECT = """
from dataclasses import dataclass
from {helper} import wave
from hil.models.effect import Doc, Effect, Param

@dataclass(frozen=True)
class Wave(Effect):
    name, family = "{name}", "friction"
    doc = Doc(equation="tau = f sin q", signature="a wave", shown_by="any", source="here")
    params = (Param("f", "{{F}}", "size", 0.0),)

    def columns(self, motion, j, shape):
        return wave(motion.q[:, j])[:, None]

EFFECTS = (Wave(),)
"""
HELPER = (
    "import numpy as np\nfrom {deep} import factor\n\n"
    "def wave(q):\n    return factor() * np.sin(q)\n"
)
MODEL = 'schema = "hil.model/1"\nplugins = ["./{name}.py"]\n[robot]\npreset = "single-axis"\n'


@pytest.fixture
def made(tmp_path, monkeypatch):
    """A model whose plugin imports a file and a package; names of their own in each test."""

    def make(name):
        (tmp_path / f"{name}.py").write_text(EFFECT.format(helper=f"{name}_help", name=name))
        (tmp_path / f"{name}_help.py").write_text(HELPER.format(deep=f"{name}_deep.inner"))
        (tmp_path / f"{name}_deep").mkdir()
        (tmp_path / f"{name}_deep" / "__init__.py").write_text("")
        (tmp_path / f"{name}_deep" / "inner.py").write_text("def factor():\n    return 2.0\n")
        model = tmp_path / f"{name}.toml"
        model.write_text(MODEL.format(name=name))
        return model

    # what a plugin adds is known to its own test alone
    monkeypatch.setattr(catalogue, "_table", dict(catalogue.table()))
    return make


def test_all_that_is_imported_is_listed_and_agreed_to(made, tmp_path, capsys):
    model = str(made("aa"))
    assert main(["trust", "--show", "--json", model]) == 0
    (row,) = json.loads(capsys.readouterr().out)["executables"]
    assert [p.rpartition("/")[2] for p in row["imports"]] == [
        "__init__.py",
        "inner.py",
        "aa_help.py",
    ]
    assert not row["agreed"]
    assert main(["trust", model]) == 0
    assert "aa_help.py" in capsys.readouterr().out
    from hil.models.files import read_model

    assert read_model(model).plugins


@pytest.mark.parametrize("changed", ["bb_help.py", "bb_deep/inner.py", "bb_deep/__init__.py"])
def test_a_change_of_any_part_is_asked_for_anew(made, tmp_path, capsys, changed):
    from hil.models.files import read_model

    model = made("bb")
    assert main(["trust", str(model)]) == 0
    ran = tmp_path / "ran"
    with (tmp_path / changed).open("a") as file:
        file.write(f"\nopen({str(ran)!r}, 'w').close()\n")
    with pytest.raises(ConfigError, match="you have not agreed to it as it is now"):
        read_model(model)
    assert not ran.exists()


def test_a_file_from_elsewhere_is_refused(tmp_path, monkeypatch, agreed):
    from hil.models.files import read_model

    place, ran = tmp_path / "elsewhere", tmp_path / "ran"
    place.mkdir()
    (place / "cc_away.py").write_text(f"open({str(ran)!r}, 'w').close()\ndef wave(q): return q\n")
    plugin = tmp_path / "cc.py"
    head = f"import sys\nsys.path.insert(0, {str(place)!r})\n"
    plugin.write_text(head + EFFECT.format(helper="cc_away", name="cc"))
    (tmp_path / "cc.toml").write_text(MODEL.format(name="cc"))
    agreed(plugin)
    monkeypatch.setattr("sys.path", ["", *__import__("sys").path])
    with pytest.raises(ConfigError, match=r"cc_away .*nobody has agreed to"):
        read_model(tmp_path / "cc.toml")
    monkeypatch.chdir(place)  # nor from the working directory
    plugin.write_text(EFFECT.format(helper="cc_away", name="cc"))
    agreed(plugin)
    with pytest.raises(ConfigError, match=r"cc_away .*nobody has agreed to"):
        read_model(tmp_path / "cc.toml")
    assert not ran.exists()


def test_what_is_installed_comes_before_what_lies_beside(tmp_path):
    (tmp_path / "numpy.py").write_text("raise SystemExit")
    (tmp_path / "json.py").write_text("raise SystemExit")
    (tmp_path / "mine.py").write_text("x = 1")
    source = b"import numpy, json\ndef late():\n    from importlib import import_module\n"
    source += b"    return import_module('mine')\n"
    assert list(local_modules(tmp_path / "p.py", source)) == ["mine"]


def test_a_plugin_of_many_files_is_no_plugin(tmp_path):
    (tmp_path / "many").mkdir()
    for k in range(201):
        (tmp_path / "many" / f"m{k}.py").write_text("")
    (tmp_path / "many" / "__init__.py").write_text("")
    with pytest.raises(ConfigError, match="more than 200 files"):
        local_modules(tmp_path / "p.py", b"import many")
