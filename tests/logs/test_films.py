from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

import tracker
from tests.helpers.log_writers import CAMERAS, write_picture
from tests.helpers.reading import peak_memory, recovered
from tracker.errors import LogError
from tracker.logs import layout
from tracker.logs.opening import recording_files


def _grey(camera: int, k: int) -> int:
    return 16 + 24 * camera + 8 * k


def pictures(camera: int, count: int) -> list[np.ndarray]:
    """Even grey, another one in each picture; a film changes it by less than half of the difference."""
    return [np.full((48, 64, 3), _grey(camera, k), np.uint8) for k in range(count)]


def shades(path: Path) -> tuple[list[list[int | None]], list[float], tuple[str, ...]]:
    """Of each frame the cameras' greys, rounded to what `pictures` made; stamps; cameras."""
    with tracker.open_log(path) as log:
        frames = list(log)
        greys = [[None if i is None else round(float(i.mean()) / 8) * 8 for i in f.images] for f in frames]
        return greys, [round(frame.timestamp, 6) for frame in frames], log.camera_names


def expected(count: int, cameras: int = 3) -> list[list[int]]:
    return [[_grey(camera, k) for camera in range(cameras)] for k in range(count)]


def write_film(path: Path, images: Sequence[np.ndarray], codec: str = "libx264", **options: str) -> Path:
    av = pytest.importorskip("av", reason="video: no module av")
    path.parent.mkdir(parents=True, exist_ok=True)
    with av.open(str(path), "w") as film:
        stream = film.add_stream(codec, rate=25, options=options)
        stream.pix_fmt = "yuvj420p" if codec == "mjpeg" else "yuv420p"
        stream.height, stream.width = images[0].shape[:2]
        stream.gop_size = 5  # so that some pictures are found from a key picture in the middle
        for image in images:
            film.mux(stream.encode(av.VideoFrame.from_ndarray(image, format="bgr24")))
        film.mux(stream.encode())
    return path


def write_numbers(folder: Path, camera: int, count: int, name: str = "{:06d}.png") -> None:
    for k, image in enumerate(pictures(camera, count)):
        write_picture(folder / name.format(k), image)


@pytest.mark.parametrize(("suffix", "codec"), [(".mp4", "libx264"), (".avi", "mjpeg")])
def test_a_film_of_each_camera_is_a_recording(tmp_path, suffix, codec):
    for camera, name in enumerate(CAMERAS):
        write_film(tmp_path / f"{name}{suffix}", pictures(camera, 12), codec)
    greys, stamps, names = shades(tmp_path)
    assert names == CAMERAS
    assert greys == expected(12)
    np.testing.assert_allclose(stamps, np.arange(12) / 25, atol=1e-6)
    with tracker.open_log(tmp_path) as log:
        assert log.image_sizes == ((64, 48),) * 3


@pytest.mark.parametrize(
    ("suffix", "codec", "options"),
    [(".mp4", "libx264", {"x264-params": "open-gop=1:bframes=3:keyint=8"}), (".avi", "mpeg4", {"bf": "2"})],
)
def test_every_picture_of_a_film_is_found_alone(tmp_path, suffix, codec, options):
    film = write_film(tmp_path / f"camera60{suffix}", pictures(0, 24), codec, **options)
    with tracker.open_log(film) as log:
        found = [frame.images[0] for frame in log]
        for number in np.random.default_rng(1).permutation(24).tolist():
            np.testing.assert_array_equal(log[number].images[0], found[number])


def test_a_film_that_was_cut_without_encoding_begins_at_the_cut(tmp_path):
    av = pytest.importorskip("av", reason="video: no module av")
    film = write_film(tmp_path / "whole.mp4", pictures(0, 12), bf="2")
    with av.open(str(film)) as whole, av.open(str(tmp_path / "camera60.mp4"), "w") as cut:
        taken = whole.streams.video[0]
        stream = cut.add_stream_from_template(taken)
        step = int(1 / (25 * taken.time_base))
        for packet in whole.demux(taken):
            if packet.size and packet.pts >= 5 * step:  # from the key picture before picture 8 on
                packet.pts, packet.dts, packet.stream = packet.pts - 8 * step, packet.dts - 8 * step, stream
                cut.mux(packet)
    greys, stamps, _ = shades(tmp_path / "camera60.mp4")
    assert (greys, stamps) == (expected(12, 1)[8:], [0.0, 0.04, 0.08, 0.12])
    with tracker.open_log(tmp_path / "camera60.mp4") as log:
        assert [round(float(log[k].images[0].mean()) / 8) * 8 for k in (3, 0, 2)] == [104, 80, 96]


@pytest.mark.parametrize(("space", "red", "blue"), [(1, 0.2126, 0.0722), (5, 0.299, 0.114)])
def test_colours_are_those_of_the_films_colour_space(tmp_path, space, red, blue):
    """BT.709 of most cameras (1), or BT.601 (5)."""
    av = pytest.importorskip("av", reason="video: no module av")
    bgr = np.array([30.0, 30.0, 200.0])
    light = bgr @ (blue, 1 - red - blue, red)
    chroma = (bgr[[0, 2]] - light) / (2 * (1 - np.array([blue, red])))
    planes = np.concatenate([np.full((48, 64), 16 + 219 / 255 * light), np.empty((24, 64))])
    planes[48:60], planes[60:] = (128 + 224 / 255 * chroma)[:, None, None]
    with av.open(str(tmp_path / "camera60.mp4"), "w") as film:
        stream = film.add_stream("libx264", rate=25, options={"crf": "1"})
        stream.pix_fmt, stream.width, stream.height = "yuv420p", 64, 48
        stream.codec_context.colorspace = space
        frame = av.VideoFrame.from_ndarray(planes.round().astype(np.uint8), format="yuv420p")
        frame.colorspace = space
        film.mux([*stream.encode(frame), *stream.encode()])
    with tracker.open_log(tmp_path / "camera60.mp4") as log:
        np.testing.assert_allclose(log[0].images[0].mean(axis=(0, 1)), bgr, atol=3)


def test_films_of_different_length_leave_a_camera_without_image(tmp_path):
    for camera, count in enumerate((6, 4)):
        write_film(tmp_path / f"{CAMERAS[camera]}.mp4", pictures(camera, count))
    greys, _, _ = shades(tmp_path)
    assert [row[1] for row in greys] == [40, 48, 56, 64, None, None]
    greys, _, names = shades(tmp_path / "camera60.mp4")  # a film alone is one camera
    assert (greys, names) == (expected(6, 1), ("camera60",))


CONCAT = b"ffconcat version 1.0\nfile 'other.mp4'\n"
HLS = b"#EXTM3U\n#EXT-X-TARGETDURATION:9\n#EXTINF:0.5,\nother.mp4\n#EXT-X-ENDLIST\n"
DASH = (
    b'<MPD xmlns="urn:mpeg:dash:schema:mpd:2011" type="static" mediaPresentationDuration="PT1S"><Period>'
    b'<AdaptationSet contentType="video"><Representation id="1" mimeType="video/mp4" bandwidth="9">'
    b"<BaseURL>other.mp4</BaseURL></Representation></AdaptationSet></Period></MPD>"
)


def test_two_films_of_one_camera_are_refused_and_others_beside_them_are_not(tmp_path):
    for name in ("camera60.avi", "camera180.mp4", "camera300.mp4", "view.mp4", "view.mkv"):
        write_film(tmp_path / name, pictures(0, 2), "mjpeg" if name.endswith(".avi") else "libx264")
    assert shades(tmp_path)[2] == CAMERAS
    write_film(tmp_path / "camera60.mp4", pictures(1, 2))
    with pytest.raises(LogError, match=r"camera60\.mp4: found camera60\.avi too, expected one film of a cam"):
        tracker.open_log(tmp_path)


@pytest.mark.parametrize("content", [b"", b"no film" * 100, None, CONCAT, HLS, DASH])
def test_what_is_no_film_is_reported_and_opens_no_file_that_it_names(tmp_path, content):
    other, film = write_film(tmp_path / "other.mp4", pictures(0, 12)), tmp_path / "camera60.mp4"
    half = other.read_bytes()[: other.stat().st_size // 2]
    for name in (b"other.mp4", str(other).encode()):
        film.write_bytes(half if content is None else content.replace(b"other.mp4", name))
        for place in (film, tmp_path):
            with pytest.raises(LogError, match=r"camera60\.mp4: found no film"):
                tracker.open_log(place)


def test_a_damaged_picture_of_a_film_is_named_and_the_others_are_given(tmp_path):
    noise = np.random.default_rng(5).integers(0, 256, (20, 48, 64, 3), np.uint8)
    film = write_film(tmp_path / "camera60.mp4", list(noise), "mpeg4")  # H.264 has other bits now and then
    content = bytearray(film.read_bytes())
    at = content.index(b"mdat") + len(content) // 2
    content[at : at + 1500] = bytes(1500)
    film.write_bytes(content)
    assert 0 < len(recovered(film, r"camera60\.mp4: image \d+")[1]) < 20


@pytest.mark.parametrize("names", [("above", "left", "right"), CAMERAS])
def test_folders_of_cameras_may_have_any_name_where_pictures_are_numbers(tmp_path, names):
    if names == CAMERAS:
        write_picture(tmp_path / "camera60_overlay.png", pictures(0, 1)[0])  # hides no folder
    for camera, name in enumerate(names):
        write_numbers(tmp_path / name, camera, 3)
    assert shades(tmp_path) == (expected(3), [0.0, 0.1, 0.2], names)
    assert shades(tmp_path / names[0]) == (expected(3, 1), [0.0, 0.1, 0.2], names[:1])
    lone = (tmp_path / names[0]).rename(tmp_path / "run #5")  # which no camera can be called
    assert shades(lone) == (expected(3, 1), [0.0, 0.1, 0.2], ("camera",))


PATTERNS = '[cameras]\nleft = "{}"\nright = "{}"\n'


@pytest.mark.parametrize(
    ("left", "right"),
    [
        *[("l/{:06d}.png", "r/{:06d}.png"), ("{}_l.png", "{}_r.png"), ("{}/x.png", "{}/y.png")],
        ("run [1]/{:06d}.png", "run?/[r]{:06d}.png"),
    ],
)
def test_a_file_says_which_pictures_are_whose(tmp_path, left, right):
    for camera, name in enumerate((left, right)):
        write_numbers(tmp_path, camera, 3, name)
    write_picture(tmp_path / "camera60_overlay.png", pictures(0, 1)[0])
    globs = [name.replace("{:06d}", "*").replace("{}", "*") for name in (left, right)]
    (tmp_path / "recording.toml").write_text("rate = 50\n" + PATTERNS.format(*globs))
    assert shades(tmp_path) == (expected(3, 2), [0.0, 0.02, 0.04], ("left", "right"))
    files = recording_files(tmp_path)
    assert {tmp_path / "recording.toml", tmp_path / left.format(2)} < set(files)


def test_a_recordings_files_are_those_that_its_patterns_reach_through_links(tmp_path):
    write_numbers(tmp_path / "elsewhere" / "l", 0, 2)
    write_numbers(tmp_path / "elsewhere" / "r", 1, 2)
    (tmp_path / "here").mkdir()
    (tmp_path / "here" / "data").symlink_to(tmp_path / "elsewhere")
    stated = tmp_path / "here" / "recording.toml"
    stated.write_text(PATTERNS.format("data/l/*.png", "data/r/*.png"))
    images = [tmp_path / "here" / "data" / side / f"00000{k}.png" for side in "lr" for k in range(2)]
    assert sorted(recording_files(tmp_path / "here")) == sorted([stated, *images])
    stated.write_text(PATTERNS.format("*/l/*.png", "data/*r/*.png"))
    assert sorted(recording_files(tmp_path / "here")) == sorted([stated, *images])
    stated.write_text("cameras = 3")
    assert recording_files(tmp_path / "here") == [stated]


def test_films_and_pictures_go_together_and_stamps_may_be_given(tmp_path):
    write_film(tmp_path / "some.mp4", pictures(0, 3))
    write_numbers(tmp_path / "r", 1, 3)
    (tmp_path / "recording.toml").write_text(PATTERNS.format("some.mp4", "r/*.png"))
    (tmp_path / "stamps.csv").write_text("100.0\n100.5\n101.25\n")
    assert shades(tmp_path)[:2] == (expected(3, 2), [100.0, 100.5, 101.25])
    (tmp_path / "stamps.csv").write_text("100.0, 100.25\n100.5, 100.75\n101.0, 101.25\n")
    with tracker.open_log(tmp_path) as log:
        assert log[1].camera_timestamps.tolist() == [100.5, 100.75]
    (tmp_path / "stamps.csv").write_text("100.0\n")
    with pytest.raises(LogError, match="found 1 lines, expected one for each of 3 frames"):
        tracker.open_log(tmp_path)


@pytest.mark.parametrize("name", ["recording.toml", "stamps.csv", "ground_truth.json"])
def test_a_description_whose_link_leads_nowhere_is_not_passed_over(tmp_path, name):
    write_numbers(tmp_path / "camera60", 1, 3)
    (tmp_path / "recording.toml").write_text("[cameras]\ncamera60 = 'camera60/*.png'\n")
    (tmp_path / name).unlink(missing_ok=True)
    (tmp_path / name).symlink_to("moved")
    with pytest.raises(LogError, match=f"{name}: cannot be read: No such file"):
        tracker.open_log(tmp_path)


@pytest.mark.parametrize(
    ("rate", "name", "first", "period"),
    [
        ("rate = 50\n", lambda k: f"r{k + 1}.png", 0, 0.02),
        ("", lambda k: f"r{1_605_000_000 + 0.04 * k:.2f}.png", 1_605_000_000, 0.04),
        ("", lambda k: f"r{1_605_000_000_000 + 40 * k}.png", 1_605_000_000, 0.04),
    ],
)
def test_a_films_first_picture_belongs_to_the_lowest_number_beside_it(tmp_path, rate, name, first, period):
    write_film(tmp_path / "some.mp4", pictures(0, 4))
    for k, image in enumerate(pictures(1, 4)):
        if k != 2:
            write_picture(tmp_path / name(k), image)
    (tmp_path / "recording.toml").write_text(rate + PATTERNS.format("some.mp4", "r*.png"))
    shown = expected(4, 2)
    shown[2][1] = None
    assert shades(tmp_path)[:2] == (shown, [first + round(period * k, 6) for k in range(4)])


@pytest.mark.parametrize(("rate", "period"), [("", 0.04), ("rate = 5\n", 0.2)])
@pytest.mark.parametrize("name", ["{}", "f{}"])
def test_pictures_of_several_cameras_belong_to_a_films(tmp_path, name, rate, period):
    write_film(tmp_path / "some.mp4", pictures(0, 3))
    write_numbers(tmp_path / "r", 1, 3, name + ".png")
    write_numbers(tmp_path / "s", 2, 3, name + ".png")
    cameras = PATTERNS.format("some.mp4", "r/*.png") + 'third = "s/*.png"'
    (tmp_path / "recording.toml").write_text(rate + cameras)
    assert shades(tmp_path)[0] == expected(3, 3)
    assert shades(tmp_path)[1] == pytest.approx([0, period, 2 * period])


@pytest.mark.parametrize("stated", ["", "camera60/*.png", "some.mp4"])
def test_pictures_named_after_their_cameras_go_together_by_order_unless_one_is_missing(stated, tmp_path):
    for c, name in enumerate(CAMERAS[:2]):
        write_numbers(tmp_path / name, c, 3, f"{name}_{{:02d}}.png")
    if stated == "some.mp4":
        write_film(tmp_path / stated, pictures(0, 3))
    if stated:
        (tmp_path / "recording.toml").write_text(PATTERNS.format(stated, "camera180/*.png"))
    assert shades(tmp_path)[0] == expected(3, 2)
    (tmp_path / "camera180" / "camera180_01.png").unlink()  # the third would be taken with the second
    with pytest.raises(LogError, match=r"found 2 images of \w+ and 3 of \w+, whose names do not show which"):
        tracker.open_log(tmp_path)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("1\n" * 200_000, "found 200000 lines, expected one for each of 1 frames"),
        ("1,2\n \n3\n", "found no table of numbers: .*columns changed from 2 to 1"),
        ("", "found no table of numbers: it is empty"),
        ("1,2", "expected finite numbers, one or 1 in each line"),
        ("nan", "expected finite numbers, one or 1 in each line"),
        ("time", "found no table of numbers: .*'time'"),
    ],
)
def test_stamps_that_are_no_table_are_refused_without_much_memory(tmp_path, monkeypatch, text, message):
    monkeypatch.setattr(layout, "_MAX_STAMPS", 1_000_000)  # which are reserved
    write_numbers(tmp_path, 0, 1)
    (tmp_path / "recording.toml").write_text("[cameras]\na = '*.png'")
    (tmp_path / "stamps.csv").write_text(text)
    with peak_memory() as used, pytest.raises(LogError, match=message):
        tracker.open_log(tmp_path)
    assert used[0] < 20 * len(text) + 4_000_000


def test_pictures_without_common_names_are_counted(tmp_path):
    write_numbers(tmp_path / "a", 0, 3, "shot{}.png")
    write_numbers(tmp_path / "b", 1, 3, "{:03d}0.png")
    write_picture(tmp_path / "b" / "0000.png", pictures(1, 1)[0])
    write_picture(tmp_path / "b" / "._0000.png", pictures(0, 1)[0])  # as macOS writes beside each file
    (tmp_path / "b" / "notes.txt").touch()
    (tmp_path / "recording.toml").write_text(PATTERNS.format("a/*.png", "b/*"))
    assert shades(tmp_path)[0] == expected(3, 2)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[cameras", "not a TOML file"),
        ("", "expected a table of 1 to 16 patterns"),
        ("cameras = 3", "expected a table"),
        ("[cameras]\na = 3", "a: found 3, expected a pattern"),
        ("[cameras]\na = '../*.png'", "inside the folder"),
        ("[cameras]\na = '/etc/*'", "inside the folder"),
        ("[cameras]\na = '.'", "inside the folder"),
        *[(f"[cameras]\na = '{pattern}'", "but no \\*\\*") for pattern in ("**/*.png", "left/**.png")],
        ("[cameras]\na = '" + 30 * "*a" + "'", "up to nine"),
        ("[cameras]\na = 'b/*.png'", "found no file that fits 'b/"),
        ("[cameras]\na = '*/*/*/*/*.png'", "found no file that fits '"),
        ("[cameras]\na = '0*.png'\nb = '*.png'", "b: found 000000.png of a, expected files of its own"),
        ("speed = 3\n[cameras]\na = '*.png'", "unknown key 'speed'"),
        ("rate = 0\n[cameras]\na = '*.png'", "rate: found 0"),
        ("rate = true\n[cameras]\na = '*.png'", "rate: found True"),
    ],
)
def test_a_malformed_file_is_refused(tmp_path, text, message):
    write_numbers(tmp_path, 0, 1)
    for name in "xy":  # through which the image fits patterns of any depth, in ever more ways
        (tmp_path / name).symlink_to(".")
    (tmp_path / "recording.toml").write_text(text)
    with pytest.raises(LogError, match=message):
        tracker.open_log(tmp_path)
