import dataclasses
import re
import shutil

import numpy as np
import pytest

import tracker
from synthetic.camera.sensor import Sensor
from tests.calibration.by_object.test_check import moved
from tests.helpers import ROOT
from tests.helpers.filmed import write_recording
from tests.helpers.kept_stills import take
from tests.helpers.log_writers import write_picture
from tests.helpers.moving_cube import carried
from tests.helpers.stills import bare_scene
from tracker.calibration.by_object.health import HEIGHT, MOST, QUANTITIES, health
from tracker.logs import open_log
from tracker.recordings.track import track
from tracker.viz.calibration import page

FRAMES = 5


@pytest.fixture(scope="module")
def film(rig, tmp_path_factory):
    """A folder of images of a cube at rest; camera300 is dark in the last two of them."""
    folder = tmp_path_factory.mktemp("health") / "film"
    rng = np.random.default_rng(11)
    scene = bare_scene(tracker.load_object("cube_v2"), rng, kind="rest")
    for k in range(FRAMES):
        images = take(scene, rig.cameras, Sensor.realistic(), rng).images
        if k >= FRAMES - 2:
            images[2] = images[2] // 4
        for name, image in zip(rig.names, images, strict=True):
            write_picture(folder / name / f"{k:06d}.png", image)
    return folder


def measured(film, rig):
    tracked = track(film, "cube_v2", rig=rig)
    one = tracker.ObjectTracker(tracker.load_object("cube_v2"), rig)
    with open_log(film) as log:
        return health(one, log, tracked.poses)


@pytest.fixture(scope="module")
def well(film, rig):
    return measured(film, rig)


@pytest.fixture(scope="module")
def text(well):
    return page(well, "<film> & co")


def test_a_rig_that_is_well_is_measured_to_be(well):
    assert well.index.tolist() == list(range(FRAMES))
    assert well.cameras == ("camera60", "camera180", "camera300")
    for key in ("residual", "blur", "brightness", "clipping", "white balance"):
        assert well.values[key].shape == (FRAMES, 3)
        np.testing.assert_array_equal(well.beyond(key)[:2], 0.0)
    assert np.nanmedian(np.abs(well.height)) < 0.5
    assert well.check is None or well.check.fits


def test_what_is_beyond_its_limit_in_some_frames_is_named_with_the_camera(well):
    assert well.values["brightness"][:-2, 2].min() > QUANTITIES["brightness"].limits[0]
    np.testing.assert_allclose(well.beyond("brightness"), [0.0, 0.0, 2 / FRAMES])
    (line,) = (text for text in well.complaints() if "brightness" in text)
    assert line.startswith("camera300: brightness")


@pytest.mark.parametrize(
    ("heights", "off"),
    [
        ([np.nan, 0.0, 0.0, 8.0, 8.0], ["+4.0"]),
        ([4.0, 4.0, 0.0, -4.0, -4.0], []),
        ([-3.5, -3.5, -3.5, 0.0, 0.0], ["-3.5"]),
        ([np.nan] * FRAMES, []),
    ],
)
def test_the_median_height_decides_whether_the_table_is_off(well, heights, off):
    lines = "\n".join(dataclasses.replace(well, height=np.array(heights)).complaints())
    assert re.findall(r"rests (\S+) mm off", lines) == off


def test_a_camera_that_was_moved_disagrees_and_a_complaint_says_so(film, rig, well):
    cameras = (rig[0], moved(rig[1], np.zeros(3), np.array([0.02, 0.0, 0.015])), rig[2])
    ill = measured(film, tracker.CameraRig(cameras, rig.arena))
    assert np.nanmedian(ill.values["disagreement"][:, 1]) > QUANTITIES["disagreement"].limits[1]
    assert np.nanmedian(well.values["disagreement"][:, 1]) < 2.0
    assert ill.check is not None
    assert not ill.check.fits
    assert "calibration does not fit" in "\n".join(ill.complaints())
    assert "calibration does not fit" not in "\n".join(well.complaints())


def test_a_page_has_the_complaints_needs_no_other_file_and_escapes_what_it_is_given(well, text):
    assert all(f'<li class="bad">{line}</li>' in text for line in well.complaints())
    assert "&lt;film&gt; &amp; co" in text
    assert text.count("data:image/png;base64,") == len(QUANTITIES) + 1
    assert not re.search(r'(src|href)="(?!data:)', text)


def test_what_was_not_measured_is_named_in_one_line_and_has_no_plot(well, text):
    empty = {key: np.full((FRAMES, 3), np.nan) for key in ("residual", "disagreement", "blur")}
    lost = dataclasses.replace(
        well, values={**well.values, **empty}, height=np.full(FRAMES, np.nan), check=None
    )
    line = "not measured: residual, disagreement, blur, table; the object was not surely found"
    assert lost.missing() == line
    nowhere = dataclasses.replace(well, height=np.full(FRAMES, np.nan))  # at rest, but there is no table
    assert nowhere.missing() == "not measured: table; the object was not seen at rest on a table"
    shown = page(lost, "film")
    assert f"N{line[1:]}." in shown
    assert shown.count("data:image/png;base64,") == len(QUANTITIES) + 1 - 4
    assert "within its limits" not in shown  # camera300 is dark
    assert "0 to 5.4 mrad" in text


def test_the_names_of_many_cameras_leave_room_for_the_plots(well):
    many = {key: np.repeat(values, 6, axis=1) for key, values in well.values.items()}
    # Matplotlib warns, which is an error here, if nothing is left of a plot.
    page(dataclasses.replace(well, values=many, cameras=tuple(f"camera{k}" for k in range(18))), "film")


def test_a_single_camera_measures_no_height(film, rig, tmp_path):
    shutil.copytree(film / rig.names[0], tmp_path / "alone" / rig.names[0])
    alone = measured(tmp_path / "alone", tracker.CameraRig(rig.cameras[:1], rig.arena))
    assert np.isfinite(alone.values["residual"]).any()
    assert np.isnan(alone.height).all()
    assert alone.missing() == "not measured: disagreement, table; there is a single camera"


def test_an_object_that_moves_is_not_taken_to_rest_wherever_it_is_found_anew(rig, tmp_path):
    found = measured(write_recording(tmp_path, list(carried()[:6])), rig)
    assert np.isfinite(found.values["residual"]).all()
    assert np.isnan(found.values["disagreement"]).all()
    assert found.check is None


def test_the_limits_are_those_that_the_documentation_states():
    text = (ROOT / "docs" / "health.md").read_text(encoding="utf-8")
    rows = {row.split("|")[1].strip(): row.split("|")[3] for row in text.splitlines() if row.startswith("| ")}
    for key, quantity in {**QUANTITIES, "table": HEIGHT}.items():
        stated = [float(number.replace("−", "-")) for number in re.findall(r"[−\d.]+\d|\d", rows[key])]
        low, high = quantity.limits
        assert round(high, 1) in stated
        assert low in (*stated, 0.0, -high)
    assert f"up to {MOST} frames" in text
