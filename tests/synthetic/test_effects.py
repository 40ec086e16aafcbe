from __future__ import annotations

import numpy as np
import pytest

from synthetic.effects import NAMES, Effects, stream
from synthetic.errors import EffectError


def test_a_text_names_what_is_on_in_one_order():
    assert Effects.of("none") == Effects.none() == Effects.of(())
    assert Effects.of("world") == Effects.all() == Effects.of(NAMES)
    assert (
        Effects.of("focus, chamfers")
        == Effects.only("chamfers", "focus")
        == Effects.of(["focus", "chamfers"])
    )
    for name in NAMES:
        assert Effects.only(name).names == (name,)


@pytest.mark.parametrize("found", ["fog", "chamfers,fog", ["fog"]])
def test_an_unknown_effect_is_refused_by_its_name(found):
    with pytest.raises(EffectError, match="effect: found 'fog', expected one of chamfers"):
        Effects.of(found)


def test_streams_of_effects_differ_by_name_seed_and_number():
    keys = [("chamfers", 1, 2), ("table", 1, 2), ("chamfers", 2, 2), ("chamfers", 1, 3)]
    draws = {stream(*key).random() for key in keys}
    assert len(draws) == len(keys)
    assert stream(*keys[0]).random() == stream(*keys[0]).random()
    assert not draws & {np.random.default_rng([1, k, 2]).random() for k in range(3)}
