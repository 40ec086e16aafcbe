import numpy as np
import pytest

from tracker.viz import paint

BOX = "\uffff"
"""A character of which there is none: fonts show a box, or nothing."""


def written(text: str, at=(8.0, 30.0), width: int = 60, **options) -> np.ndarray:
    picture = np.zeros((40, width, 3), np.uint8)
    paint.put_text(picture, text, at, paint.WHITE, **{"size": 16.0, **options})
    return picture


def test_letters_of_many_languages_and_signs_of_units_are_drawn():
    letters = [*"aouäöüÄÖÜßéèêçñåøłšžČ°±×µ²³–−≤σ√→αω", BOX]
    pictures = {written(letter).tobytes() for letter in letters}
    assert len(pictures) == len(letters)
    assert written("a").any()


def test_text_is_as_wide_as_stated_and_starts_and_ends_where_it_should():
    text, image_width = "Würfel ±0.5°", 300
    width = paint.text_width(text, 16.0)
    for align in (0.0, 0.5, 1.0):
        picture = written(text, (150.0, 30.0), image_width, align=align)
        columns = np.flatnonzero(picture.any(axis=(0, 2)))
        assert abs(columns[0] - (150 - align * width)) < 3
        assert abs(columns[-1] - (150 + (1 - align) * width)) < 3


def test_digits_are_as_high_as_is_asked_for_and_equally_wide():
    for size in (9.0, 12.0, 14.4, 18.0):
        rows = np.flatnonzero(written("8", (8.0, 30.0), size=size).any(axis=(1, 2)))
        assert abs(rows[-1] - rows[0] + 1 - size) < 0.2 * size
        assert rows[-1] in (29, 30)
        assert len({paint.text_width(digit, size) for digit in "0123456789"}) == 1


@pytest.mark.parametrize(
    "at", [(-25.0, 30.0), (40.0, 30.0), (8.0, 3.0), (8.0, 48.0), (-400.0, 9.0), (8.0, 900.0)]
)
def test_text_beyond_the_borders_is_cut_off(at):
    large = np.zeros((3 * 1040, 3 * 460, 3), np.uint8)
    paint.put_text(large, "Text", (at[0] + 460, at[1] + 1040), paint.WHITE, size=16.0)
    np.testing.assert_array_equal(written("Text", at), large[1040:1080, 460:520])


def test_no_text_changes_nothing():
    assert not written("").any()
