import dataclasses
import os
from pathlib import Path

import numpy as np
import pytest

from tracker.errors import ObjectModelError
from tracker.geometry.cuboid import FACE_NAMES
from tracker.objects import model
from tracker.objects.labels import COLOR_NAMES, DISPLAY_COLORS_BGR
from tracker.objects.model import CuboidModel, load_object, object_names, to_toml

VALID = """
name = "mine"
size = [0.05, 0.06, 0.07]
colors = "cube_v2"

[faces]
"+x" = "red"
"-x" = "yellow"
"+y" = "green"
"-y" = "magenta"
"+z" = "blue"
"-z" = "cyan"
"""


@pytest.fixture
def mine(tmp_path):
    """A valid file."""
    file = tmp_path / "mine.toml"
    file.write_text(VALID)
    return file


@pytest.mark.parametrize("name", ["cube_v1", "cube_v2", "cube_v3", "cuboid_2x2x8_v2"])
def test_an_object_is_what_the_platform_uses(name):
    assert name in object_names()
    model = load_object(name)
    colors = {face: COLOR_NAMES[label] for face, label in zip(FACE_NAMES, model.face_labels, strict=True)}
    first = name == "cube_v1"
    assert model.name == model.colors == name
    assert colors == {
        "+x": "red",
        "+y": "green",
        "+z": "blue",
        "-z": "cyan",
        "-x": "yellow" if first else "magenta",
        "-y": "magenta" if first else "yellow",
    }
    size = [0.02, 0.08, 0.02] if name.startswith("cuboid") else [0.065] * 3
    np.testing.assert_array_equal(model.size, size)


@pytest.mark.parametrize(
    ("name", "real"), [("simulated_cube", "cube_v2"), ("simulated_cuboid", "cuboid_2x2x8_v2")]
)
def test_a_simulated_object_is_the_real_one_with_sharp_edges(name, real):
    drawn, model = load_object(name), load_object(real)
    np.testing.assert_array_equal(drawn.size, model.size)
    np.testing.assert_array_equal(drawn.face_labels, model.face_labels)
    assert (drawn.name, drawn.colors, drawn.rim) == (name, "simulation", 0.0)
    assert drawn.rim_std < model.rim_std


def test_labels_have_the_order_of_the_contract():
    assert COLOR_NAMES == ("background", "red", "green", "blue", "cyan", "magenta", "yellow")
    np.testing.assert_array_equal(DISPLAY_COLORS_BGR[COLOR_NAMES.index("red")], [0, 0, 255])
    np.testing.assert_array_equal(DISPLAY_COLORS_BGR[COLOR_NAMES.index("cyan")], [255, 255, 0])


def test_a_file_of_ones_own_is_read_with_colors_named_like_the_object_unless_given(mine):
    for path in (mine, str(mine)):
        model = load_object(path)
        assert (model.name, model.colors) == ("mine", "cube_v2")
        np.testing.assert_array_equal(model.size, [0.05, 0.06, 0.07])
        np.testing.assert_array_equal(model.face_labels, [1, 6, 2, 5, 3, 4])
    mine.write_text(VALID.replace('colors = "cube_v2"\n', ""))
    assert load_object(mine).colors == "mine"
    longer = "x" * 300  # than the name of any file
    mine.write_text(VALID.replace("cube_v2", longer))
    assert load_object(mine).colors == longer


def test_colors_beside_the_file_are_found_from_anywhere(mine, monkeypatch):
    mine.write_text(VALID.replace("cube_v2", "table.npz"))
    table = mine.with_name("table.npz")
    assert Path(load_object(mine).colors) == table  # none in the current folder instead
    table.touch()
    monkeypatch.chdir(os.sep)
    assert Path(load_object(mine).colors) == table


def test_names_in_any_script_are_read_as_written(mine):
    named = dataclasses.replace(load_object("cube_v2"), name='würfel "🎲"\x7f\\', colors="🎲.npz")
    mine.write_text(to_toml(named), encoding="utf-8")
    read = load_object(mine)
    assert (read.name, read.colors) == (named.name, str(mine.with_name("🎲.npz")))
    undecodable = os.fsdecode(b"w\xfcrfel")  # a name in Latin-1
    with pytest.raises(ObjectModelError, match=r"'w.udcfcrfel': cannot be written: "):
        to_toml(dataclasses.replace(named, name=undecodable))


@pytest.mark.parametrize("change", [{"size": [0.0645] * 3}, {"face_labels": [2, 1, 3, 4, 5, 6]}])
def test_another_object_may_not_have_the_name_of_one_in_the_package(change, mine):
    shipped = load_object("cube_v2")
    mine.write_text(to_toml(dataclasses.replace(shipped, rim=1e-4)))
    assert load_object(mine).rim == 1e-4
    mine.write_text(to_toml(dataclasses.replace(shipped, **change)))
    with pytest.raises(ObjectModelError, match="name: found cube_v2, an object of another size"):
        load_object(mine)


def test_the_format_in_the_docstring_is_valid(mine):
    lines = model.__doc__.splitlines()
    mine.write_text("\n".join(line[4:] for line in lines if line.startswith("    ")))
    np.testing.assert_array_equal(load_object(mine).face_labels, load_object("cube_v2").face_labels)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('"red"', '"orange"', r"\+x: found 'orange', expected one of red"),
        ('"red"', '"background"', "found 'background'"),
        ('"red"', "[1]", "found a list of 1"),
        ('"red"', "0x" + "f" * 5000, "faces: .x: found "),
        ('"red"', '"cyan"', "found cyan twice"),
        ('"+x" = "red"\n', "", "faces: found"),
        ('"+x"', '"+w"', "faces: found"),
        ("[0.05, 0.06, 0.07]", "[0.05, 0.06]", "size"),
        ("[0.05, 0.06, 0.07]", "0.05", "size: found 0.05"),
        ("[0.05, 0.06, 0.07]", "[0.05, 0.06, nan]", "size: found nan"),
        ("[0.05, 0.06, 0.07]", "[0.05, 0.06, true]", "size: found True"),
        ("[0.05, 0.06, 0.07]", "[50, 60, 70]", "edges from 0.005 to 0.5 m"),
        ("[0.05, 0.06, 0.07]", "[0.05, 0.06, 0.004]", "edges from"),
        ("size =", "length =", "unknown key .length., expected some of name, size"),
        ("size = [0.05, 0.06, 0.07]", "", "'size' is missing"),
        ('"mine"', "3", "name: found 3"),
        ('"mine"', '"mine', "not a TOML file"),
        ('colors = "cube_v2"', "colors = 1", "colors: found 1"),
    ],
)
def test_a_malformed_file_names_file_and_fault(old, new, message, mine):
    mine.write_text(VALID.replace(old, new, 1))
    with pytest.raises(ObjectModelError, match=message) as caught:
        load_object(mine)
    assert str(mine) in str(caught.value)


@pytest.mark.parametrize(
    ("key", "value"),
    [
        *[("face_labels", value) for value in ([1, 2, 3, 4, 5, 5], [0, 1, 2, 3, 4, 5], [1, 2, 3, 4, 5])],
        ("face_labels", np.arange(12).reshape(6, 2)),
        ("size", np.full(3, np.inf)),
        *[("rim", value) for value in (-1e-4, 0.02, "wide")],
        *[("rim_std", value) for value in (0.0, 0.02, float("nan"))],
        ("name", ""),
        ("colors", None),
    ],
)
def test_a_model_is_validated_at_construction(key, value):
    with pytest.raises(ObjectModelError, match=key):
        dataclasses.replace(load_object("cube_v2"), **{key: value})


def test_what_is_not_there_is_named_with_what_is(tmp_path):
    with pytest.raises(ObjectModelError, match=r"'cube_v9'.*cube_v1, cube_v2, cube_v3, cuboid_2x2x8_v2"):
        load_object("cube_v9")
    with pytest.raises(ObjectModelError, match=r"none\.toml: cannot be read: No such file"):
        load_object(tmp_path / "none.toml")
    (tmp_path / "box.txt").write_text(to_toml(load_object("cube_v2")))
    with pytest.raises(ObjectModelError, match=r"unknown object .*, or the path of a \.toml file"):
        load_object(tmp_path / "box.txt")


def test_arrays_are_read_only():
    model = CuboidModel("mine", [0.05] * 3, [1, 2, 3, 4, 5, 6], "mine")
    with pytest.raises(ValueError, match="read-only"):
        model.size[0] = 1
