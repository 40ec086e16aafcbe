import numpy as np

import tracker
from scripts.fit_confidence import Cases, Model
from tests.helpers import ROOT
from tracker.color_learning.labelled import read_image
from tracker.pose.evidence import NUMBERS
from tracker.pose.judge import SINGLE, confidence, disputed, rank
from tracker.pose.rivals import lead


def test_the_numbers_are_fitted_to_the_confidence_that_the_tracker_states():
    demo = ROOT / "tracker" / "demo"
    one = tracker.ObjectTracker("cube_v2", demo)
    estimator, cases, expected = one._estimator, Cases(), []
    for frame in (0, 7):
        images = [read_image(demo / f"{frame:06d}" / f"{name}.jpg") for name in one.rig.names]
        for given in (images, [images[0], images[2], images[1]]):
            sight, found = estimator.reader(given), []
            for fit in estimator.candidates(sight):
                fit = fit.changed(resized=estimator.search.resized(sight, fit))
                found.append(estimator.examined(sight, fit))
            cases.add(found, [False] * len(found), one.model, "demo", frame)
            ranked = sorted(found, key=rank, reverse=True)
            radius = 0.5 * float(np.linalg.norm(one.model.size))
            expected += [fit.changed(lead=lead(fit, ranked, radius)) for fit in found]
    assert any(map(disputed, expected))
    stated = Model(cases).confidence(NUMBERS._asdict() | {"single": SINGLE})
    np.testing.assert_allclose(stated, [fit.inside * confidence(fit) for fit in expected], atol=1e-3)
