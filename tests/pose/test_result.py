import json

import numpy as np
import pytest

from tracker import CameraUse, MotionEstimate, Observation, PoseEstimate, Status, TrackerError
from tracker.geometry import so3
from tracker.pose.result import Forecast, MotionKind


@pytest.mark.parametrize("word", [*Status, *CameraUse])
def test_a_status_is_its_name_in_snake_case_wherever_texts_go(word):
    text = word.name.lower()
    assert word == text
    assert str(word) == f"{word}" == format(word, "") == text
    assert json.loads(json.dumps({"status": word})) == {"status": text}
    assert f"{word:>20}" == text.rjust(20)
    assert {word: 1}[text] == 1
    assert type(word)(text) is word


COVARIANCE = np.diag([1e-8, 4e-8, 9e-8, *np.radians([0.1, 0.2, 0.3]) ** 2])
POSE = PoseEstimate([0.1, -0.02, 0.0325], [0.0, 0.0, 0.6, 0.8], COVARIANCE, 0.9512)
MOTION = (*(POSE.position, POSE.orientation, COVARIANCE, 0.5), [0.03, 0.04, 0, 0, 0, 1], np.eye(6))


def test_a_pose_is_shown_with_its_units_and_deviations_and_an_observation_with_what_a_person_asks_for():
    text = repr(POSE)
    assert "100.00 -20.00 32.50 ± 0.10 0.20 0.30 mm" in text
    assert "0.0000 0.0000 0.6000 0.8000 ± 0.10 0.20 0.30°, confidence 0.951" in text
    assert "50 mm/s, 57 °/s, confidence 0.500" in repr(MotionEstimate(*MOTION))
    kind = MotionKind(*MOTION, "at rest", 0.75)
    assert repr(kind).startswith("MotionKind(")
    assert "at rest 0.75" in repr(kind)
    assert "at rest 0.75, confidence" in repr(Forecast(*MOTION, (kind,)))
    uses = (CameraUse.USED, CameraUse.NO_IMAGE)
    found = repr(Observation(POSE, None, Status.FOUND, {"total": 4.21}, cameras=uses))
    assert found.startswith("Observation(found; cameras used, no_image; 4.2 ms;")
    assert repr(POSE) in found
    lost = repr(Observation(None, None, Status.LOST, reason=Status.POOR_FIT))
    assert " ".join(lost.split()) == "Observation(lost, since poor_fit; no pose)"


def test_covariances_of_keypoints_are_those_of_samples_where_the_size_is_known():
    rng = np.random.default_rng(5)
    root = rng.normal(size=(6, 6)) * ([[1e-3]] * 3 + [[5e-3]] * 3)
    turn = np.array([0.1, -0.2, 0.3, 0.9]) / np.linalg.norm([0.1, -0.2, 0.3, 0.9])
    pose = PoseEstimate([0.1, 0.0, 0.03], turn, root @ root.T, 0.9, size=[0.02, 0.08, 0.03])
    steps = rng.normal(size=(200_000, 6)) @ root.T
    turned = (pose.keypoints - pose.position) @ np.swapaxes(so3.exp(steps[:, 3:]), -1, -2)
    samples = steps[:, None, :3] + turned
    expected = np.array([np.cov(corner.T) for corner in samples.transpose(1, 0, 2)])
    limit = 0.02 * np.abs(expected).max()
    np.testing.assert_allclose(pose.keypoint_covariances, expected, rtol=0.02, atol=limit)
    # A box of unknown size has none.
    for name in ("keypoints", "keypoint_covariances"):
        with pytest.raises(TrackerError, match="without the object's size"):
            getattr(POSE, name)
