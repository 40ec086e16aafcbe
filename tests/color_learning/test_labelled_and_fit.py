import dataclasses
import io
import os
import zipfile

import cv2
import numpy as np
import pytest
from PIL import Image

from tests.helpers import exposed
from tests.helpers.stated_sizes import KINDS, encoded, of_size
from tracker.color_learning.fit import FitOptions, combine, image_histograms
from tracker.color_learning.labelled import LabelledImage, intersection_over_union, read_image, read_labelled
from tracker.errors import ColorModelError, ImageError
from tracker.objects.labels import COLOR_NAMES
from tracker.segmentation import ColorModel, load_colors, segment
from tracker.segmentation.light import apply_gains

SIZE = 160
OPTIONS = FitOptions(draws=8000)
DICE = load_colors("dice")
COVERED = LabelledImage("covered", np.full((40, 40, 3), 90, np.uint8), np.ones((40, 40), np.uint8))
FACE_BGR = {
    "red": (45, 45, 185),
    "green": (60, 160, 60),
    "blue": (140, 55, 20),
    "cyan": (170, 150, 50),
    "magenta": (150, 50, 150),
    "yellow": (45, 200, 210),
}


def labelled_image(seed: int, light=(1.0, 1.0, 1.0)) -> LabelledImage:
    """Six shaded squares, at places drawn at random, on uneven grey."""
    rng = np.random.default_rng(seed)
    ramp = np.linspace(*rng.uniform(90, 140, 2), SIZE)[:, None, None]
    image = ramp * np.ones((SIZE, SIZE, 3))
    labels = np.zeros((SIZE, SIZE), np.uint8)
    for label, cell in enumerate(rng.permutation(9)[:6], start=1):
        row, column = (50 * k + 5 + rng.integers(10) for k in divmod(cell, 3))
        square = slice(row, row + 36), slice(column, column + 36)
        image[square] = np.array(FACE_BGR[COLOR_NAMES[label]]) * rng.uniform(0.85, 1.15)
        labels[square] = label
    return LabelledImage(f"scene{seed}", exposed(image * light + rng.normal(0, 3, image.shape)), labels)


def fitted(seeds=(0, 1, 2), options=OPTIONS):
    histograms = [image_histograms(labelled_image(seed), options) for seed in seeds]
    return combine(histograms, options=options)


@pytest.fixture(scope="module")
def model():
    return fitted()


@pytest.mark.parametrize("seed", [10, 11, 12])
def test_a_fitted_model_segments_images_it_has_not_seen(seed, model):
    scene = labelled_image(seed)
    overlaps = intersection_over_union(segment(scene.image, model), scene.labels)
    assert list(overlaps) == [1, 2, 3, 4, 5, 6]
    assert min(overlaps.values()) > 0.95


@pytest.mark.parametrize("gains", [(1.2, 1.0, 0.85), (0.8, 0.9, 1.1), (0.6, 0.6, 0.6), (1.25, 1.25, 1.25)])
def test_a_change_of_light_does_not_change_the_labels(gains, model):
    scene = labelled_image(20)
    lit = apply_gains(scene.image, np.array(gains))
    before, after = (segment(image, model) for image in (scene.image, lit))
    assert (before == after).mean() > 0.99
    assert min(intersection_over_union(after, scene.labels).values()) > 0.95


def test_a_ramp_of_coloured_light_does_not_change_what_is_learned():
    ramp = np.ones((SIZE, SIZE, 3))
    ramp[..., 0], ramp[..., 2] = np.linspace(0.6, 1.4, SIZE), np.linspace(1.4, 0.6, SIZE)
    scene = labelled_image(10)
    seen = combine([image_histograms(labelled_image(seed, ramp), OPTIONS) for seed in (0, 1, 2)])
    assert min(intersection_over_union(segment(scene.image, seen), scene.labels).values()) > 0.95


def test_a_fit_without_normalisation_takes_colours_as_they_are():
    options = FitOptions(draws=8000, brightness=0.05, tail_share=0.0)
    histograms = image_histograms(labelled_image(0), options, normalise=False)
    model = combine([histograms], options=options, normalise=False)
    scene = labelled_image(10, light=(0.2, 0.2, 0.2))
    assert model.normalise is False
    assert (segment(scene.image, model) == scene.labels).mean() < 0.9


def test_the_same_seed_fits_the_same_bits_whatever_was_drawn_before():
    first = fitted((0,))
    for density in image_histograms(labelled_image(2), OPTIONS).values():
        assert density.min() >= 0
        assert density.sum() == pytest.approx(1)
    assert fitted((0,)).log_posterior.tobytes() == first.log_posterior.tobytes()
    other = fitted((0,), FitOptions(draws=8000, seed=1))
    assert first.log_posterior.tobytes() != other.log_posterior.tobytes()


def test_what_is_not_shaded_or_shaded_by_nothing_is_as_it_was():
    scene = labelled_image(0)
    red = LabelledImage(scene.name, scene.image, np.where(scene.labels == 1, 1, 0).astype(np.uint8))
    densities = [
        image_histograms(red, FitOptions(draws=8000, shaded_share=share, shade=shade, veil=veil))[1]
        for share, shade, veil in ((0.0, 0.1, 200.0), (0.0, 0.9, 10.0), (1.0, 1.0, 200.0))
    ]
    assert len({density.tobytes() for density in densities}) == 1


def test_a_training_colour_keeps_its_label_in_shade_and_under_a_veil(rng):
    labels = np.repeat(np.arange(1, 7), 200)
    faces = np.array([FACE_BGR[COLOR_NAMES[label]] for label in labels], dtype=float)
    left = rng.uniform(0.4, 1, (len(labels), 1))
    veiled = left * faces + (1 - left) * rng.uniform(0, 110.0, (len(labels), 1))
    levels = np.rint(np.clip(veiled, 0, 255)).astype(int)
    kept = {}
    for share in (0.0, OPTIONS.shaded_share):
        options = FitOptions(draws=8000, shaded_share=share)
        model = combine([image_histograms(labelled_image(0), options, normalise=False)], options=options)
        cells = model.channel_tables(np.ones(3))[np.arange(3), levels].sum(axis=1)
        kept[share] = np.mean(model.label_table[cells] == labels)
    assert kept[OPTIONS.shaded_share] > 0.99
    assert kept[0.0] < 0.95


@pytest.mark.parametrize("veil", [0.0, 120.0])
def test_a_shaded_face_is_a_mixture_of_itself_and_the_veil(veil):
    scene = labelled_image(0)
    plain = {"draws": 10000, "brightness": 0.0, "channel": 0.0, "haze": 0.0, "noise": 0.0, "tail_share": 0.0}
    means = []
    for share in (0.0, 1.0):
        options = FitOptions(**plain, shaded_share=share, shade=0.2, veil=veil)
        density = image_histograms(scene, options, normalise=False)[6]
        levels = 255 * (np.arange(32) / 31) ** 2
        means.append([(density.sum(axis=tuple({0, 1, 2} - {k})) * levels).sum() for k in range(3)])
    # s has mean 0.6 and is independent of the veil, whose mean is half of its most.
    np.testing.assert_allclose(means[1], 0.6 * np.array(means[0]) + 0.4 * veil / 2, atol=2.0)


def test_other_objects_images_teach_colours_that_the_own_ones_lack_and_other_tints_than_they_show():
    scene, unseen = labelled_image(0), labelled_image(10)
    histograms = image_histograms(scene, OPTIONS)
    own = {label: density for label, density in histograms.items() if label != 4}
    without, as_own = combine([own]), combine([own], [histograms])
    as_others = combine([own], [image_histograms(scene, OPTIONS.for_others())])
    assert not (segment(unseen.image, without) == 4).any()
    assert intersection_over_union(segment(unseen.image, as_own), unseen.labels)[4] > 0.9
    purple = scene.image.copy()
    purple[scene.labels == 4] = FACE_BGR["cyan"] * np.array([1.3, 0.8, 0.6])
    found = [np.mean(segment(purple, one)[scene.labels == 4] == 4) for one in (as_own, as_others)]
    assert found[0] < 0.1
    assert found[1] > 0.4


@pytest.mark.parametrize("best", [0.0, -20.0])
def test_a_saved_model_is_read_back_whatever_its_best_class_has(best, model, tmp_path):
    dataclasses.replace(model, log_posterior=model.log_posterior + best).save(tmp_path / "mine.npz")
    read = load_colors(tmp_path / "mine.npz")
    assert read.name == "mine"
    assert read.normalise is model.normalise
    # Steps of 1/16, and nothing below 255 of them.
    np.testing.assert_allclose(read.log_posterior, np.maximum(model.log_posterior, -255 / 16), atol=1 / 32)
    read.save(tmp_path / "again.npz")
    assert (tmp_path / "again.npz").read_bytes() == (tmp_path / "mine.npz").read_bytes()
    scene = labelled_image(10)
    assert (segment(scene.image, read) == segment(scene.image, model)).mean() > 0.999
    assert sorted(path.name for path in tmp_path.iterdir()) == ["again.npz", "mine.npz"]
    assert load_colors((tmp_path / "again.npz").rename(tmp_path / "again")).name == "again"


def written(save, *arrays, **entries) -> bytes:
    buffer = io.BytesIO()
    save(buffer, *arrays, **entries)
    return buffer.getvalue()


def saved(**replaced) -> bytes:
    table = np.zeros((7, 32, 32, 32), np.uint8)
    entries = {"format": np.int64(1), "normalise": np.bool_(True), "log_posterior": table, **replaced}
    given = {key: value for key, value in entries.items() if value is not None}
    return written(np.savez_compressed, **given)


def with_broken_stream() -> bytes:
    """A file whose directory is sound and whose compressed data are not."""
    rng = np.random.default_rng(0)
    content = saved(log_posterior=rng.integers(0, 9, (7, 32, 32, 32), dtype=np.uint8))
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        start = archive.getinfo("log_posterior.npy").header_offset + 60
    return content[:start] + b"\xff" * 400 + content[start + 400 :]


def zipped(**members: bytes) -> bytes:
    """A file with other members in place of those of a colour model."""
    buffer = io.BytesIO(saved(**dict.fromkeys(members)))
    with zipfile.ZipFile(buffer, "a") as archive:
        for name, content in members.items():
            archive.writestr(name, content)
    return buffer.getvalue()


FAULTY_FILES = {
    "empty": b"",
    "text": b"not a colour model",
    "truncated": saved()[:-200],
    "broken stream": with_broken_stream(),
    "one array": written(np.save, np.zeros(3)),
    "no table": saved(log_posterior=None),
    "no format": saved(format=None),
    "later format": saved(format=np.int64(2)),
    "format in words": saved(format=np.array("one")),
    "two flags": saved(normalise=np.array([True, False])),
    "table of floats": saved(log_posterior=np.zeros((7, 32, 32, 32))),
    "small table": saved(log_posterior=np.zeros((6, 32, 32, 32), np.uint8)),
    "text in place of an array": zipped(format=b"1"),
    "table without a head": zipped(log_posterior=bytes(7 * 32**3)),
    "long head": zipped(normalise=written(np.save, np.zeros(1, [(f"a{k}", "u1") for k in range(2000)]))),
    "format in lines": saved(format=np.array("one\ntwo")),
    "objects": saved(log_posterior=np.array({}, dtype=object)),
}


@pytest.mark.parametrize("fault", FAULTY_FILES)
def test_a_faulty_file_is_named(fault, tmp_path):
    (tmp_path / "faulty.npz").write_bytes(FAULTY_FILES[fault])
    with pytest.raises(ColorModelError, match=r"faulty\.npz") as printed:
        load_colors(tmp_path / "faulty.npz")
    assert "\n" not in str(printed.value)


@pytest.mark.parametrize("without", ["normalise", "log_posterior", "nothing"])
def test_a_later_format_is_called_so_whatever_else_its_file_holds(without, tmp_path):
    (tmp_path / "later.npz").write_bytes(saved(**{without: None}, format=np.int64(2)))
    with pytest.raises(ColorModelError, match="format 2; this version reads format 1"):
        load_colors(tmp_path / "later.npz")


@pytest.mark.parametrize(
    ("image", "masks"),
    [
        ("07_image.png", "07_mask_{}.png"),
        ("camera60.png", "{:.1}60.png"),
        ("camera60_image.png", "camera60_mask_{}.png"),
        ("my_image_7_image.png", "my_image_7_mask_{}.png"),
    ],
)
def test_both_layouts_of_labelled_images_are_read(image, masks, tmp_path):
    scene = labelled_image(3)
    for label, color in list(enumerate(COLOR_NAMES))[1:5]:  # magenta and yellow have no mask
        mask = np.where(scene.labels == label, np.uint8(1), np.uint8(0))
        cv2.imwrite(str(tmp_path / masks.format(color)), np.repeat(mask[..., None], 4, axis=2))
    cv2.imwrite(str(tmp_path / image), scene.image)
    for path in list(tmp_path.iterdir()):
        (tmp_path / f"._{path.name}").touch()  # of a file system for Macs
    (read,) = read_labelled(tmp_path)
    np.testing.assert_array_equal(read.image, scene.image)
    np.testing.assert_array_equal(read.labels, np.where(scene.labels > 4, 0, scene.labels))


@pytest.mark.parametrize("name", ["mine", os.fsdecode(b"w\xfcrfel")])
def test_images_have_the_same_names_and_so_the_same_draws_wherever_they_are_read_from(
    name, tmp_path, monkeypatch
):
    folder = tmp_path / name
    folder.mkdir()
    monkeypatch.chdir(folder)
    cv2.imwrite("1_image.png", labelled_image(3).image)
    cv2.imwrite("1_mask_red.png", labelled_image(3).labels)
    for given in (folder, ".", f"../{name}", ""):
        (one,) = read_labelled(given)
        assert one.name == f"{name}/1_image"
        assert set(image_histograms(one, FitOptions(draws=10))) == {0, 1}


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (lambda folder: load_colors("pink"), r"'pink'.*cube_v1.*simulation"),
        (lambda folder: load_colors("missing.npz"), r"missing\.npz: cannot be read: No such file"),
        (lambda folder: DICE.save(folder / "no" / "a.npz"), r"a\.npz: cannot be written: there"),
        (lambda folder: ColorModel("high", DICE.log_posterior + 1), "'high': .*found 1, expect"),
        (lambda folder: ColorModel("no", DICE.log_posterior, "no"), "normalise: found 'no'"),
        (lambda folder: read_labelled(folder / "empty"), "none found"),
        (lambda folder: read_labelled(folder / "nowhere"), "no such folder"),
        (lambda folder: read_labelled(folder), "01_mask_red"),
        (lambda folder: read_labelled(folder / "unused"), r"02_mask_Red\.png: found no 02_image"),
        (lambda folder: read_labelled(folder / "lone"), r"r300\.png: found no camera300\.png"),
        (lambda folder: read_labelled(folder / "capital"), r"R60\.png: found no camera60\.png for it, or no"),
        (lambda folder: read_image(folder / "nothing.png"), r"nothing\.png"),
        (lambda folder: read_image(folder / "text.png"), r"text\.png"),
        (lambda folder: read_image(folder / "pipe.png"), r"pipe\.png: cannot be read: found a pipe"),
        (lambda folder: read_labelled(folder / "piped"), r"g60\.png: cannot be read: found a pipe"),
        (lambda folder: read_image(folder / "image.png"), r"image\.png"),
        (lambda folder: image_histograms(COVERED, OPTIONS), "covered.*background"),
    ],
)
def test_what_cannot_be_read_or_taught_is_named(given, message, tmp_path):
    (tmp_path / "empty").mkdir()
    (tmp_path / "unused").mkdir()
    for name in ("02_image", "02_mask_green", "02_mask_Red"):
        cv2.imwrite(str(tmp_path / "unused" / f"{name}.png"), np.zeros((20, 20, 3), np.uint8))
    for folder, masks in (("lone", ("g60", "r300")), ("capital", ("g60", "R60")), ("piped", ())):
        (tmp_path / folder).mkdir()
        for name in ("camera60", *masks):
            cv2.imwrite(str(tmp_path / folder / f"{name}.png"), np.zeros((20, 20, 3), np.uint8))
    for name in ("pipe.png", "piped/g60.png"):
        os.mkfifo(tmp_path / name)
    (tmp_path / "nothing.png").write_bytes(b"")
    (tmp_path / "text.png").write_bytes(b"text")
    cv2.imwrite(str(tmp_path / "01_image.png"), np.zeros((20, 20, 3), np.uint8))
    cv2.imwrite(str(tmp_path / "01_mask_red.png"), np.zeros((20, 30), np.uint8))
    with pytest.raises((ColorModelError, ImageError), match=message):
        given(tmp_path)


@pytest.mark.parametrize("kind", KINDS)
def test_an_image_of_any_format_is_read_whole_or_named(kind, tmp_path, rng):
    image = rng.integers(0, 256, (30, 40, 3), dtype=np.uint8)
    whole = encoded(kind, image)
    path = tmp_path / f"image.{kind}"
    path.write_bytes(whole)
    plain = read_image(path)
    assert plain.shape == image.shape
    if kind == "jpg":
        tag = Image.Exif()
        tag[0x112] = 3  # upside down, which fixed cameras are not
        app1 = b"\xff\xe1" + (len(tag.tobytes()) + 2).to_bytes(2, "big") + tag.tobytes()
        path.write_bytes(whole[:2] + app1 + whole[2:] + bytes(5000))  # as telephones append a film
    np.testing.assert_array_equal(read_image(path), plain if kind == "jpg" else image)
    for share in (0.3, 0.7):
        path.write_bytes(whole[: int(share * len(whole))])
        with pytest.raises(ImageError, match=rf"image\.{kind}"):
            read_image(path)
    path.write_bytes(of_size(kind, 8193, 8192))
    with pytest.raises(ImageError, match=rf"image\.{kind}: found 8193×8192 px, expected at most 67108864"):
        read_image(path)


def test_the_overlap_of_equal_maps_is_one_and_of_disjoint_ones_zero():
    truth = np.array([[0, 1, 1], [2, 2, 0]], np.uint8)
    assert intersection_over_union(truth, truth) == {1: 1.0, 2: 1.0}
    assert intersection_over_union(np.where(truth == 1, 2, 0), truth) == {1: 0.0, 2: 0.0}
    found = intersection_over_union(np.array([[0, 1, 0], [2, 2, 2]]), truth)
    assert found == {1: 0.5, 2: pytest.approx(2 / 3)}
