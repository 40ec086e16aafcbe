"""What commands refuse before they do anything; each case in the same folder, which stays as it is."""

import dataclasses
import json
import os
import shlex
import shutil
import struct
from pathlib import Path
from typing import Any

import click
import cv2
import numpy as np
import pytest

import tracker
from tests.helpers import RIG
from tests.helpers.command import assert_refused
from tests.helpers.log_writers import make_content, write_hdf5, write_picture
from tests.helpers.pose_logs import random_poses
from tests.helpers.recording_stubs import make_job, write_log
from tracker.cli import commands
from tracker.cli.demo import DATA
from tracker.cli.outputs import OutFile, OutFolder
from tracker.objects.model import to_toml
from tracker.poses.file import write_poses
from tracker.recordings import run

FACES = "+x=red,-x=magenta,+y=green,-y=yellow,+z=blue,-z=cyan"

ONE, TWO, THREE = (f"demo/000003/camera{number}.jpg" for number in (60, 180, 300))
FAULTY = (
    *((image, image) for image in ("void", "text", "truncated")),
    ("missing", "no such file"),
    ("folder", "no such file, but a folder"),
    ("large", "270×270"),
)
"""Folders of a faulty picture, and words of the message."""

COUNTS = [
    (f"{ONE} {TWO}", "found 2|expected 3|camera60|camera180|camera300"),
    (f"{ONE} {TWO} {THREE} {THREE}", "found 4|expected 3"),
    ("none none none", "'none'|at least one"),
]

NAMED = [
    ("camera60.jpg camera300.jpg", "camera300.jpg: named after camera300|camera60, camera180"),
    ("camera300.jpg camera60.jpg", "named after camera300"),
    ("camera300.jpg a.jpg", "named after camera300"),
    ("camera60.jpg camera60.jpg", "named after camera60, as "),
    ("camera60.jpg a.jpg", "a.jpg: named after no camera"),
    ("a.jpg camera60.jpg", "a.jpg: named after no camera"),
    ("camera60-camera180.jpg camera180.jpg", "named after camera180 and camera60"),
    ("camera300/a.jpg camera60/a.jpg", "named after camera300"),
]
SURPLUS = ("camera60.jpg camera180.jpg a.jpg", "found 3|expected 2"), ("camera60.jpg", "found 1|expected 2")
"""Pictures of other cameras than the calibration's, which are two."""

REFUSED = {
    "": [
        ("find", "No such command|find"),
        ("colors", "Missing command|colors --help"),
        ("detect", "IMAGE|detect --help"),
        ("detect x.png", "--object"),
        ("detect x.png --object cube_v2", "--calibration|folder|camera60.yml"),
        ("detect x.png --objet cube_v2", "--objet"),
        ("colors fit .", "--name|-o"),
        ("colors adapt . --object cube_v2", "-o"),
        ("colors fit nowhere -o x.npz", "nowhere|no such folder"),
        ("colors fit nowhere -o x.npz --seed -1", "--seed|-1"),
        ("colors check .", "--colors|--cross-validate"),
        ("colors check . --colors pink", "pink|cube_v2"),
        ("colors check . --colors cube_v2", "none found|NN_mask_red.png"),
        ("colors check imgs --cross-validate --others ./imgs", "found imgs again"),
        ("colors fit imgs --others imgs -o x.npz", "found imgs again"),
        ("colors check imgs --colors cube_v2 --plot imgs/x.png", "that are read"),
    ],
    f"detect {ONE} {TWO} {THREE} --json --overlay out.png --object": [
        ("cube_v9 --calibration demo", "cube_v9|cube_v2"),
        ("nothing.toml --calibration demo", "nothing.toml"),
        ("cube_v2 --calibration demo --colors pink", "pink|simulation"),
        ("cube_v2 --calibration demo --colors pink.npz", "pink.npz"),
        ("cube_v2 --calibration demo --pattern *.yaml", "*.yaml"),
        ("cube_v2 --calibration demo --frame 1", "--frame"),
        ("cube_v2 --calibration nowhere", "nowhere"),
        ("cube_v2 --calibration folder", "camera60.yml"),
        ("cube_v2 --calibration broken", "camera60.yml|YAML"),
        ("cube_v2", "--calibration"),
    ],
    "detect --object cube_v2 --json --calibration demo": [
        *COUNTS,
        *((f"{ONE} {image}/camera180.png {THREE} --overlay out.png", words) for image, words in FAULTY),
        (f"{ONE} large/camera180.png {THREE} --overlay large/camera180.png", "that is an input"),
    ],
    "detect --object cube_v2 --calibration two": [*NAMED, *SURPLUS],
    "dice --calibration two": [*NAMED, *SURPLUS],
    "calibrate check --object cube_v2 --calibration two": [
        *NAMED,
        *((pictures, "multiple of 2") for pictures, _ in SURPLUS),
    ],
    "detect --object cube_v2 --calibration sides": [
        ("top.jpg left.jpg", "top.jpg: named after no camera|left, right"),
        ("left.jpg top.jpg", "top.jpg: named after no camera|left, right"),
    ],
    "detect --object cube_v2 --json": [
        ("demo --frame 20", "no frame 20|from 0 to 19"),
        ("empty.dat --calibration demo", "no frame 0, expected one from a recording that has some"),
    ],
    "dice --json --calibration demo": [
        *COUNTS,
        (f"{ONE} {TWO} {THREE} --goal nowhere.json", "nowhere.json|cannot be read"),
        (f"{ONE} {TWO} {THREE} --goal demo/camera60.yml", "camera60.yml|row 1"),
        (f"{ONE} {TWO} {THREE} --exact", "--exact|--goal"),
        (f"{ONE} {TWO} {THREE} --masks dice.json", "dice.json"),
        (f"named/dice_camera60.png {TWO} named/goal_camera300.png --masks named", "that is an input"),
        ("demo --masks demo", "folder of images"),
        (f"{ONE} {TWO} {THREE} --masks . --overlay dice_camera60.png", "same file"),
        (f"{ONE} {TWO} {THREE} --pattern *.yaml", "*.yaml"),
        (f"{ONE} {TWO} {THREE} --colors x", "--colors"),
    ],
    "export": [
        ("poses.h5", "--csv"),
        ("poses.h5 --csv poses.csv", "that is an input (see tracker export --help)"),
        ("poses.h5 --bop a.csv", "--camera"),
        ("poses.h5 --video a.mp4", "--log"),
        ("poses.h5 --tum a.tum --keypoints", "--keypoints: found no table"),
        ("poses.h5 --csv a.csv --keypoints --object cuboid_2x2x8_v2", "poses of cube_v2"),
        ("job --csv x.csv", "job: found a folder, expected a file of poses"),
        ("none --csv x.csv", "none: found no such file, expected a file of poses"),
        ("other.h5 --video film.mp4 --log job", "poses of another recording"),
    ],
    "convert": [
        ("job -o no/folder", "there is no folder no"),
        ("job -o folder", "exists, expected a new name"),
        ("job -o ''", "'-o'|found an empty path"),
        ("job -o new.zip", ".zip"),
        ("job -o new.mp4 --resize-calibration", "a film keeps no calibration"),
        ("job -o job/camera_data.dat", "that is the recording"),
        ("job -o job/camera_data.h5", "would be read in place of job"),
        ("imgs -o imgs/camera_data.h5", "would be read in place of imgs"),
        ("cut -o new.h5", "camera_data.dat"),
        ("job -o new.h5 --from 8", "`--from 8`|the recording has frames 0 to 7"),
        ("job -o new.h5 --from 2 --to 2", "expected --to beyond --from"),
        ("poses.h5 -o new.h5", "poses.h5: found a file of 'trifinger-object-tracker poses'"),
    ],
    "view": [
        ("poses.h5 -o v.rrd --from 3 --to 3", "beyond"),
        ("poses.h5 -o v.rrd --from 99", "--from 99"),
        ("poses.h5 -o v.rrd --calibration log", "the calibration is in"),
        ("poses.h5 -o v.rrd --object cube_v1", "expected cube_v2"),
        ("poses.h5 -o v.rrd --log log", "28×24"),
        ("poses.h5 -o v.rrd --colors cube_v2", "nothing is tracked"),
        ("log -o v.rrd", "--object"),
        ("log -o v.rrd --object cube_v2 --colors no", "'no'"),
    ],
    "score": [
        (".", "goal.json|--goal"),
        ("cut/camera_data.dat", "found no cut/goal.json|--goal"),
        ("job --poses poses.h5", "poses of another recording"),
        ("jbo --goal job/goal.json --poses poses.h5", "jbo: no such file or folder"),
        ("job --poses poses.h5 --object cuboid_2x2x8_v2", "poses of cube_v2"),
        ("job --poses poses.h5 --goal dice.json", "a goal of dice"),
        ("job --poses poses.h5 --resize-calibration", "the calibration is in this file of poses"),
        ("job --poses poses.h5 --every 7", "--every 7: only for a goal of dice"),
        ("job", "--object"),
    ],
    "track --object cube_v2": [
        ("job cut -o poses.h5", "found a file, expected a folder"),
        ("bare/camera_data.dat -o new.h5", "expected --calibration"),
        ("log log/camera_data.dat -o all --csv all.csv", "expected one"),
        ("log log/camera_data.dat -o all --camera camera60", "expected one"),
        ("nothing.dat -o new.h5", "nothing.dat"),
        ("imgs -o new.h5 --plot imgs/camera60/000000.png", "that is the recording"),
        ("imgs -o new.h5 --plot imgs/camera60_overlay.png", "folder of images"),
        ("imgs -o new.h5 --video imgs/camera60.mp4", "folder of images"),
        ("imgs -o new.h5 --csv imgs/stamps.csv", "folder of images"),
        ("imgs -o imgs/camera_data.h5", "would be read in place of imgs"),
        ("log -o no/new.h5", "there is no folder"),
        ("log -o log/camera60.yml", "that is the recording's calibration"),
        ("log -o log/new.yml", ".h5"),
        ("log -o log/camera_data.dat", "that is the recording"),
        ("log -o other/camera60.yml --calibration other", "that is an input"),
        ("log -o new", "no suffix"),
        ("log -o ''", "'-o'|found an empty path"),
        ("'' -o new.h5", "RECORDING...|found an empty path"),
        ("log -o linked.h5", "that is the recording"),
        ("log -o hard.h5", "that is the recording's calibration"),
        ("log -o goal.h5", "that is a file of the recording's folder"),
        ("log -o log.h5", "holds no poses"),
    ],
    "track log -o new.h5 --object": [
        ("cube_v9", "cube_v9"),
        ("mine.toml --csv mine.csv", "that is an input"),
        ("cube_v2 --from 9", "the recording has frames 0 to 4"),
        ("cube_v2 --from 3 --to 3", "beyond"),
        ("cube_v2 --jobs 0", "--jobs"),
        ("cube_v2 --csv calibration.csv", "that is the recording's calibration"),
        ("cube_v2 --bop bop.csv", "--camera"),
        ("cube_v2 --bop bop.csv --camera camera7", "camera60, camera180, camera300"),
        ("cube_v2 --csv a.csv --bop ./a.csv --camera camera60", "same file"),
        ("cube_v2 --pattern *.yml", "--calibration"),
        ("cube_v2 --calibration other", "28×24"),
        ("cube_v2 --calibration ''", "--calibration|found an empty path"),
        ("cube_v2 --colors ''", "--colors|found an empty path"),
    ],
    "batch": [
        ("run job --object cube_v2 -o poses.h5", "found a file, expected a folder"),
        ("run log --object cube_v2 -o out --slurm --htcondor", "one of them"),
        ("run log --object cube_v2 -o out --jobs 2 --scheduler tcp://127.0.0.1:1", "one of them"),
        ("run log --object cube_v2 -o out --dry-run", "--htcondor or --slurm"),
        ("run log --object cube_v2 -o out --slurm --dry-run --csv", "--csv|tracker batch status"),
        ("run log --object cube_v2 -o out --jobs 0", "--jobs"),
        ("run log --object cube_v2 -o out --colors none.npz", "none.npz"),
        ("run log --object cube_v2 -o out --from 3 --to 2", "beyond"),
        ("run log --object cube_v2 -o out --workers 2", "No such option"),
        ("run log --object cube_v9 -o out", "cube_v9"),
        ("run log --object cube_v2 -o ''", "'-o'|found an empty path"),
        ("run '' --object cube_v2 -o out", "RECORDING|found an empty path"),
        ("run none/* --object cube_v2 -o out", "fits this pattern"),
        ("status log", "batch.json"),
    ],
    "live --object cube_v2": [
        ("log --rate 5", "--rate|has no effect"),
        ("log --settings x.toml", "--settings|has no effect"),
        ("log --public", "--public|--publish"),
        ("log --publish tcp://0.0.0.0:5555", "other machines could connect"),
        ("log --publish udpm://239.255.76.67:7667?ttl=1", "other machines could receive it"),
        ("log --publish tcp://127.0.0.1:5555 --body box", "--body|lcm://"),
        *((f"log {name} nan", f"{name}|found nan") for name in ("--seconds", "--speed", "--rate")),
        ("log --page 70000", "--page|70000|65535"),
        ("log --view --rrd a.rrd", "--view|--rrd"),
        ("log --record x.h5 --publish file://x.h5", "file://x.h5|same file"),
        ("log --publish file://a --publish file://./a", "file://./a|same file"),
        ("log --check --record new.h5", "--check|does not track"),
        ("log --pattern x", "--pattern"),
        ("nowhere", "nowhere|no such file"),
        ("webcam:0", "webcam:0|opencv:0,1,2"),
        ("opencv:0,1,2", "opencv:0,1,2|--calibration"),
        ("simulation --calibration x", "--calibration|its own"),
        ("simulation --speed 2", "--speed|has no effect"),
        ("simulation:2", "simulation:2|without a name"),
    ],
    "calibrate intrinsics void/camera180.png --squares 5x7 --square 0.04 --marker 0.03 -o new.yml": [
        ("--name camera60 --crop 540", "--crop|'540'|540x540+88+0"),
        ("--name ../x", "--name|'../x'|up to 100 letters"),
        ("--name camera60 --squares 5by7", "--squares|5x7"),
        ("--name camera60 --marker 0.05", "markers of 0.05|less than"),
        ("--name camera60", "void/camera180.png: named after camera180, expected photos of camera60"),
        ("--name camera180 camera300/a.jpg camera300/b.jpg", "camera300/a.jpg: named after camera300"),
        ("--name camera60 camera61.png", "camera180.png: found 0 bytes"),
    ],
    "colors adapt": [
        ("log --object cube_v9 -o x.npz", "cube_v9|cube_v2"),
        ("log --object cube_v2 -o x.npz --colors pink", "pink|simulation"),
        ("log --object cube_v2 -o mine.npz --colors mine.npz", "mine.npz|input"),
        ("log --object cube_v2 -o x.npz --frames 2", "--frames|2"),
        ("log --object cube_v2 -o x.npz --rounds 0", "--rounds|0"),
        ("log --object cube_v2 -o x.npz --calibration nowhere", "nowhere"),
        ("nothing --object cube_v2 -o x.npz", "no such file"),
    ],
    "colors new log -o x.npz": [
        ("", "--size|--faces"),
        ("--size 1,2,3", "--faces"),
        (f"--size a,b,c --faces {FACES}", "--size|3 numbers, X,Y,Z"),
        (f"--size 0.1,0.1 --faces {FACES}", "--size|3 numbers"),
        (f"--size 0.1,0.1,nan --faces {FACES}", "--size|nan"),
        (f"--size 65,65,65 --faces {FACES}", "65|0.5"),
        (f"-o cube_v2.npz --size 0.1,0.1,0.1 --faces {FACES}", "an object in the package"),
        (f"--size .1,.1,.1 --faces {FACES.replace('cyan', 'pink')}", "pink|cyan"),
        (f"--size .1,.1,.1 --faces {FACES.replace('cyan', 'red')}", "red|twice"),
        ("--size .1,.1,.1 --faces +x=red", "+x|-z"),
        (f"--size .1,.1,.1 --faces {FACES},+x=red", "+x|twice"),
        ("--size .1,.1,.1 --object cube_v2", "--object|--size"),
        (f"--size .1,.1,.1 --faces {FACES} -o mine.npz", "mine.toml|--object"),
        (f"--size .1,.1,.1 --faces {FACES} -o broken.npz", "broken.toml: exists"),
    ],
}
"""By the beginning of commands: their ends, and words of the messages."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Recordings demo, log, job, cut (damaged), bare (without calibration), imgs; what may be confused."""
    root = tmp_path_factory.mktemp("refused")
    shutil.copytree(DATA, root / "demo")
    whole = cv2.imencode(".png", cv2.imread(str(root / ONE)))[1].tobytes()
    large = cv2.imencode(".png", np.zeros((540, 540, 3), np.uint8))[1].tobytes()
    faulty = {"void": b"", "text": b"no image", "truncated": whole[: len(whole) // 2], "large": large}
    for name in (*faulty, "bare", "other", "broken", "folder/camera180.png"):
        (root / name).mkdir(parents=True)
    for name, content in faulty.items():
        (root / name / "camera180.png").write_bytes(content)
    (root / "broken" / "camera60.yml").write_text("camera_name: [")
    log, job, cut = (write_log(root / name, count) for name, count in (("log", 5), ("job", 8), ("cut", 8)))
    (root / "bare" / log.name).write_bytes(log.read_bytes())
    cut.write_bytes(cut.read_bytes()[:-100])
    rig = tracker.CameraRig.load(root / "demo")
    tracker.CameraRig(rig.cameras[:2]).save(root / "two")
    sides = (dataclasses.replace(rig[k], name=name) for k, name in enumerate(("left", "right")))
    tracker.CameraRig(tuple(sides)).save(root / "sides")
    for pictures in ("left.jpg top.jpg", *(pictures for pictures, _ in (*NAMED, *SURPLUS))):
        for name in pictures.split():
            (root / name).parent.mkdir(exist_ok=True)
            shutil.copy(root / ONE, root / name)
    (root / "named").mkdir()
    for name in ("dice_camera60", "goal_camera300"):
        shutil.copy(root / ONE, root / "named" / f"{name}.png")
    write_hdf5(root / "log.h5", make_content(1))
    (root / "empty.dat").write_bytes(struct.pack("<IQ", 1, 0))
    write_picture(root / "imgs" / "camera60" / "000000.png", np.zeros((24, 28, 3), np.uint8))
    RIG.save(root / "other")
    write_poses(root / "poses.h5", random_poses(np.random.default_rng(20240607), 20))
    own = run(make_job(job, root / "own.h5")).poses
    write_poses(root / "other.h5", dataclasses.replace(own, timestamp=own.timestamp + 1.0))
    (root / "job" / "goal.json").write_text(json.dumps([[0, [0.1, 0, 0.05]]]))
    (root / "dice.json").write_text(json.dumps([[0.0, 0.0, 0.011]] * 25))
    (root / "log" / "goal.json").write_text("{}")
    (root / "mine.toml").write_text(to_toml(tracker.load_object("cube_v2")))
    tracker.load_colors("cube_v2").save(root / "mine.npz")
    (root / "poses.csv").symlink_to("poses.h5")
    (root / "linked.h5").symlink_to(log)
    (root / "broken.toml").symlink_to("away")
    links = {"hard.h5": "log/camera60.yml", "calibration.csv": "log/camera60.yml", "goal.h5": "log/goal.json"}
    for name, to in {**links, "mine.csv": "mine.toml"}.items():
        os.link(root / to, root / name)
    return root


@pytest.mark.parametrize(
    ("command", "words"),
    [(f"{begin} {end}", words) for begin, cases in REFUSED.items() for end, words in cases],
)
def test_what_cannot_be_done_is_one_line_and_changes_nothing(command, words, folder, run_here):
    if ".mp4" in command:
        pytest.importorskip("av", reason="video: no module av")
    if command.startswith("view"):
        pytest.importorskip("rerun", reason="rerun: no module rerun")
    assert_refused(run_here, folder, shlex.split(command), *words.split("|"))


@pytest.mark.parametrize(
    ("option", "file", "extra"),
    [("--plot", "x.png", "plot"), ("--video", "x.mp4", "video"), ("--parquet", "x.parquet", "cluster")],
)
def test_a_package_that_is_missing_is_named_before_anything_is_written(
    option, file, extra, folder, run_here, monkeypatch
):
    monkeypatch.setattr("tracker.cli.outputs.find_spec", lambda _: None)
    command = ("export", "poses.h5", "--csv", "x.csv", option, file)
    assert_refused(run_here, folder, command, f"{option} needs the package ", f"'.[{extra}]'")


def files_written(group: click.Group = commands) -> list[Any]:
    """The options of all commands that name a file to write."""
    found = []
    context = click.Context(group)
    for name in group.list_commands(context):
        command = group.get_command(context, name)
        own = [param for param in command.params if isinstance(param.type, OutFile)]
        found += [pytest.param(param, id=f"{name} {param.opts[0]}") for param in own]
        found += files_written(command) if isinstance(command, click.Group) else []
    return found


@pytest.mark.parametrize("option", files_written())
def test_a_file_to_write_has_its_suffix_and_a_folder_to_be_in_and_is_none(option, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    last = option.type.suffixes[-1]
    (tmp_path / f"folder{last}").mkdir()
    os.mkfifo(tmp_path / f"pipe{last}")
    (tmp_path / f"link{last}").symlink_to(f"away/x{last}")
    faults = {"x.zip": f"found suffix '.zip', expected .*{last}", f"folder{last}": "found a folder, expected"}
    faults[f"pipe{last}"] = "found a pipe or a device, expected a file"
    if not option.type.new_folders:
        faults[f"nowhere/x{last}"] = "there is no folder nowhere"
        faults[f"link{last}"] = "there is no folder /.*/away"
    for path, fault in faults.items():
        with pytest.raises(click.UsageError, match=f"{option.opts[0]} {path}: {fault}"):
            option.type.convert(path, option, None)


def test_a_folder_of_results_that_exists_may_be_in_one_that_may_not_be_written(tmp_path, monkeypatch):
    (tmp_path / "old").mkdir()
    monkeypatch.setattr("os.access", lambda path, mode: Path(path) != tmp_path)
    assert OutFolder().convert(tmp_path / "old", None, None) == tmp_path / "old"
    with pytest.raises(click.UsageError, match="may not be written"):
        OutFolder().convert(tmp_path / "new", None, None)


def test_a_link_to_nothing_is_no_folder_of_results(tmp_path):
    (tmp_path / "link").symlink_to("away")
    with pytest.raises(click.UsageError, match="link: found a link to nothing, expected a folder"):
        OutFolder(new=True).convert(tmp_path / "link", None, None)
