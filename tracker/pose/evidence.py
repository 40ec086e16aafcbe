"""Evidence for a fit, from each camera's label counts and edges, against everything else they could show."""

import math
from typing import NamedTuple

import numpy as np

from tracker.compiled import compiled
from tracker.geometry.linear import sum_from
from tracker.pose.align import count_labels

HIDDEN_SHARES = np.array([0.0, 0.1, 0.25, 0.45, 0.65, 0.85, 0.97])
"""Candidate shares of a face that are hidden."""

HIDDEN_PRIOR = np.array([0.45, 0.15, 0.12, 0.1, 0.08, 0.05, 0.05])
"""Prior probability of each."""

BACKGROUND = 0.97
"""Probability that a hidden pixel shows no face colour, and that a visible pixel of a face shows one."""

LEAST_RMS, WIDTH = 0.1, 6.0
"""Smallest RMS residual of matched pieces of edge, and range of unmatched ones [px]."""

MIXED = 7
"""A face may have no colour (0), one of the six, or all mixed (MIXED)."""

RESIZED = (0.9, 0.5), (0.8, 0.5), (1.4, 1.0)
"""Rival bodies: length of one edge relative to the object's, and the share of the most favourable camera's
gain that does not count: a finger hides an end from one camera, whereas a shorter body has no end there in
any; colours beside the object may come from one bad image."""

LEAST_LACKING = 0.05
"""Pixels missing or beside the object, relative to those that show it, above which such rivals are tried."""

NONE_PRIOR = 0.5
"""Probability that an unknown face has no colour; the seven other options are equally likely."""


class Numbers(NamedTuple):
    """Weights of the evidence, fitted by scripts/fit_confidence.py to right and wrong fits.

    `end`, `resized` and `whole` were chosen on development scenes; `pixel`, `hidden`, `broken`, `body`
    and `nothing` were refitted when pixels on outlines stopped counting (benchmarks/development.md).
    """

    pixel: float
    """Independent observations per label-map pixel that lies wholly inside a face."""
    whole: float
    """The same if pixels on its outline count, too, as for bodies with one edge shorter or longer."""
    wrong: float
    """Probability that a pixel of a face shows another colour."""
    misread: float
    """Probability that a camera reads a face as another colour, in unusual light."""
    hidden: float
    """Probability that the object is hidden from a camera."""
    broken: float
    """Odds that an image is broken: taken at another moment, mirrored, tinted; their square for each further
    image: what breaks one camera seldom breaks another."""
    alike: float
    """Probability that a camera shows something similar where the object is not."""
    colored: float
    """Probability of face colours where the object is not."""
    inlier: float
    """Weight of a matched piece of edge: how many independent edges it counts as."""
    lacking: float
    """Cost of a piece that shows no edge although its faces are visible."""
    outside: float
    """Cost of face colours outside the object, per e-fold."""
    end: float
    """Weight of how much better a body with one edge shorter or longer explains the label maps."""
    stands: float
    """Weight of the log odds that the object stands on the table."""
    temper: float
    """Share of the evidence that counts, since cameras and faces are not independent."""
    body: float
    """Prior log odds of a body with other face colours."""
    resized: float
    """Prior log odds of a body with one edge shorter or longer."""
    nothing: float
    """Prior log odds that there is no such body."""


NUMBERS = Numbers(
    pixel=0.153, whole=0.0415, wrong=6.75e-06, misread=0.00143, hidden=0.0315, broken=0.0208,
    alike=1.68e-05, colored=0.113, inlier=0.0734, lacking=0.192, outside=0.35, end=1.5,
    stands=0.337, temper=0.706, body=-5.63, resized=-4.0, nothing=2.89,
)  # fmt: skip


FULL_WEIGHT = 3.0
"""Number of cameras with which NUMBERS were fitted. Up to this number, each counts in full; more share its
weight, since many see the same occluders and the same model errors."""


@compiled
def _prices(numbers, prices):  # type: ignore[no-untyped-def]
    """Fill prices (HIDDEN_SHARES, 5): log likelihood of a partly hidden face's pixel, over a hidden face's.

    Columns: a pixel without colour, in the face's colour, in another one, in any colour if the face has all;
    and the log prior of the share.
    """
    wrong, right = numbers.wrong / 5.0, BACKGROUND - numbers.wrong
    missed, mixed, other = 1.0 - BACKGROUND, BACKGROUND / 6.0, (1.0 - BACKGROUND) / 6.0
    for h in range(len(HIDDEN_SHARES)):
        seen, hidden = 1.0 - HIDDEN_SHARES[h], HIDDEN_SHARES[h]
        prices[h, 0] = math.log((seen * missed + hidden * BACKGROUND) / BACKGROUND)
        prices[h, 1] = math.log((seen * right + hidden * other) / other)
        prices[h, 2] = math.log((seen * wrong + hidden * other) / other)
        prices[h, 3] = math.log((seen * mixed + hidden * other) / other)
        prices[h, 4] = math.log(HIDDEN_PRIOR[h])


@compiled
def _option(counts, colored, k, prices, pixel):  # type: ignore[no-untyped-def]
    """Log likelihood of a face's counts (7,) if its colour is k, over that of a hidden face.

    colored: how many of the pixels have a face colour.
    """
    own, which = (counts[k], 1) if k < MIXED else (colored, 3)
    most, total = -1e300, 0.0
    for turn in range(2):
        for h in range(len(HIDDEN_SHARES)):
            value = counts[0] * prices[h, 0] + own * prices[h, which] + (colored - own) * prices[h, 2]
            value = pixel * value + prices[h, 4]
            if turn == 0:
                most = max(most, value)
            else:
                total += math.exp(value - most)
    return most + math.log(total)


@compiled
def _options(counts, prices, pixel, out):  # type: ignore[no-untyped-def]
    """Fill out (8,) with `_option` of each colour."""
    colored = sum_from(counts, 1)
    out[:] = 0.0
    if counts[0] + colored == 0:
        return
    for k in range(1, MIXED + 1):
        if 1 < k < MIXED and counts[k] == 0 and counts[k - 1] == 0:
            out[k] = out[k - 1]
        else:
            out[k] = _option(counts, colored, k, prices, pixel)


@compiled
def _unknown(options):  # type: ignore[no-untyped-def]
    """Log likelihood of the counts of an unknown face."""
    total = NONE_PRIOR * math.exp(options[0])
    for k in range(1, MIXED + 1):
        total += (1.0 - NONE_PRIOR) / MIXED * math.exp(min(options[k], 600.0))
    return math.log(total)


@compiled
def _edges(one, numbers, noisy):  # type: ignore[no-untyped-def]
    """Log likelihood of a camera's pieces of edge (a record of SEEN), for a pose.

    noisy: whether image noise counts as misfit; otherwise it averages out over the pieces of an edge.
    """
    squares = one.squares if noisy else max(one.squares - (1.0 - numbers.inlier) * one.noise, 0.0)
    rms = max(math.sqrt(squares / one.inliers) if one.inliers > 0.0 else 0.0, LEAST_RMS)
    value = numbers.inlier * one.inliers * math.log(WIDTH / (math.sqrt(2.0 * math.pi * math.e) * rms))
    lacking = max(one.agree / max(one.predicted, 1) * one.expected - one.usable, 0.0)
    return value - numbers.lacking * lacking


@compiled
def _outside(one, numbers):  # type: ignore[no-untyped-def]
    """Cost of face colours outside the object (a record of SEEN)."""
    colored = one.extra + max(one.elsewhere, 0)
    return numbers.outside * math.log1p(colored / (0.3 * one.predicted + 30.0))


@compiled
def _together(whole, broken, count, numbers):  # type: ignore[no-untyped-def]
    """Log likelihood of `count` cameras, each either whole or broken: whole (C,), broken (C,)."""
    none, ways = -1e300, np.empty(count + 1)
    for k in range(count + 1):
        ways[k] = none if k > 0 else 0.0
    for c in range(count):
        for k in range(c + 1, -1, -1):
            ways[k] = np.logaddexp(ways[k] + whole[c], ways[k - 1] + broken[c] if k > 0 else none)
    total = ways[0]
    for k in range(1, count + 1):
        odds = (2 * k - 1) * math.log(numbers.broken)
        total = np.logaddexp(total, ways[k] + odds)
    return total


@compiled
def _weigh_faces(seen, numbers, closer, options, tied, unknowns):  # type: ignore[no-untyped-def]
    """Fill options (C, 6, 8), log likelihoods of faces' counts if they have each colour, and unknowns (C, 6).

    options and tied (6, 8), their sums over the cameras, are initially zero; other arguments as in `weigh`.
    """
    prices = np.empty((len(HIDDEN_SHARES), 5))
    _prices(numbers, prices)
    correct, lost = math.log(1.0 - numbers.misread), math.log(numbers.misread)
    unseen = _unknown(tied[0])
    for c in range(len(seen)):
        for face in range(6):
            counts, pixel = seen[c].faces[face], numbers.whole
            if closer:
                counts, pixel = seen[c].inner[face], numbers.pixel
            unknowns[c, face] = unseen
            if sum_from(counts, 0) == 0:
                continue
            option, value = options[c, face], 0.0
            _options(counts, prices, pixel, option)
            unknowns[c, face] = _unknown(option)
            before = np.nan
            for k in range(MIXED + 1):
                if option[k] != before:  # colours without pixels are equally likely
                    before = option[k]
                    value = np.logaddexp(before + correct, unknowns[c, face] + lost)
                option[k] = value
                tied[face, k] += value


@compiled
def weigh(seen, face_labels, stands, numbers, closer):  # type: ignore[no-untyped-def]
    """Log evidence for the object here, for other face colours, for another shape, and for nothing.

    See equation (21) of docs/how-it-works.md.

    Args:
        seen: (C,) of SEEN; `shows` and `broken` are filled in.
        face_labels: (6,) of the object.
        stands: log odds that it stands on the table.
        numbers: Numbers.
        closer: whether only pixels wholly inside a face count, and image noise is not a misfit of edges.
    """
    count, count_seen, nothing = len(seen), 0, 0.0
    options, tied, unknowns = np.zeros((count, 6, 8)), np.zeros((6, 8)), np.empty((count, 6))
    _weigh_faces(seen, numbers, closer, options, tied, unknowns)
    lone = np.empty((4, count))
    shows, blind = math.log(1.0 - numbers.hidden), math.log(numbers.hidden)
    for c in range(count):
        one = seen[c]
        one.shows, one.broken = 0.0, 0.0
        if one.predicted == 0:
            continue
        edges = _edges(one, numbers, not closer)
        own, other, unknown = edges, edges, 0.0
        for face in range(6):
            own += options[c, face, face_labels[face]]
            best = 0
            for k in range(1, MIXED + 1):
                best = k if tied[face, k] > tied[face, best] else best
            other += options[c, face, best]
            unknown += unknowns[c, face]
        outside = _outside(one, numbers)
        lone[0, count_seen] = np.logaddexp(shows + own - outside, blind - outside)
        lone[1, count_seen] = np.logaddexp(shows + other - outside, blind - outside)
        lone[2, count_seen] = np.logaddexp(shows + own - edges, blind)
        lone[3, count_seen] = unknown
        broken = math.log(numbers.broken) + unknown
        whole = np.logaddexp(lone[0, count_seen], broken)
        one.shows, one.broken = math.exp(shows + own - outside - whole), math.exp(broken - whole)
        count_seen += 1
        empty = np.logaddexp(math.log(1.0 - numbers.colored), math.log(numbers.colored) + unknown)
        nothing += np.logaddexp(empty, math.log(numbers.alike) + own - outside)
    here = _together(lone[0], lone[3], count_seen, numbers) + numbers.stands * stands
    body = _together(lone[1], lone[3], count_seen, numbers) + numbers.stands * stands
    return here, body, _together(lone[2], lone[3], count_seen, numbers), nothing


@compiled
def _seen_here(one, unknowns, face_labels, prices, numbers):  # type: ignore[no-untyped-def]
    """Log likelihood of one camera's record of SEEN if the object is there.

    unknowns (6,): `_unknown` of its faces.
    """
    own, unknown = _edges(one, numbers, True), 0.0
    correct, lost = math.log(1.0 - numbers.misread), math.log(numbers.misread)
    for face in range(6):
        unknown += unknowns[face]
        colored = sum_from(one.faces[face], 1)
        if one.faces[face, 0] + colored > 0:
            value = _option(one.faces[face], colored, face_labels[face], prices, numbers.whole)
            own += np.logaddexp(value + correct, unknowns[face] + lost)
    shown = np.logaddexp(math.log(1.0 - numbers.hidden) + own, math.log(numbers.hidden))
    return np.logaddexp(shown - _outside(one, numbers), math.log(numbers.broken) + unknown)


@compiled
def _lacks(seen, factor, share):  # type: ignore[no-untyped-def]
    """Whether so much is missing, or beside the object, that a body of another length is tried (RESIZED)."""
    total, most, agree = 0.0, 0.0, 0.0
    for one in seen:
        room = one.missing if factor < 1.0 else one.extra
        total, most, agree = total + room, max(most, room), agree + one.agree
    return total - share * most >= LEAST_LACKING * agree


@compiled
def resized(lenses, labels, pictures, box, place, room, seen, numbers):  # type: ignore[no-untyped-def]
    """Log odds of the best body with one edge shorter or longer than an object's.

    See equation (21) of docs/how-it-works.md; arguments are as in `judge`, which has filled seen.
    room: how far a body may reach below the object [m]; farther down, the table mirrors it.
    """
    (rotation, position, lags), (half, face_labels) = place, box
    if not (_lacks(seen, *RESIZED[0]) or _lacks(seen, *RESIZED[-1])):
        return -np.inf
    prices = np.empty((len(HIDDEN_SHARES), 5))
    _prices(numbers, prices)
    other, changed, moved, found = seen.copy(), np.empty(3), np.empty(3), -np.inf
    before, unknowns, options = np.empty(len(seen)), np.empty((len(seen), 6)), np.empty(8)
    for c in range(len(seen)):
        for face in range(6):
            _options(seen[c].faces[face], prices, numbers.whole, options)
            unknowns[c, face] = _unknown(options)
        before[c] = _seen_here(seen[c], unknowns[c], face_labels, prices, numbers)
    for factor, share in RESIZED:
        if not _lacks(seen, factor, share):
            continue
        for end in range(6):
            axis, side = end // 2, 2.0 * (end % 2) - 1.0
            shift = side * half[axis] * (factor - 1.0)
            if factor > 1.0 and 2.0 * shift * rotation[2, axis] > room:
                continue
            for i in range(3):
                changed[i] = half[i] * factor if i == axis else half[i]
                moved[i] = position[i] - shift * rotation[i, axis]
            count_labels(lenses, labels, pictures, (changed, face_labels), rotation, moved, lags, other)
            total, most = 0.0, 0.0
            for c in range(len(seen)):
                if seen[c].predicted > 0:
                    gain = _seen_here(other[c], unknowns[c], face_labels, prices, numbers) - before[c]
                    total, most = total + gain, max(most, gain)
            found = max(found, total - share * most)
    return numbers.end * found + numbers.resized


@compiled
def evidence_of(seen, face_labels, stands, numbers):  # type: ignore[no-untyped-def]
    """Return the fields of Evidence; arguments are as in `weigh`."""
    here, _, _, nothing = weigh(seen, face_labels, stands, numbers, False)
    ahead, count = here - nothing, 0
    here, body, shape, nothing = weigh(seen, face_labels, stands, numbers, True)
    for one in seen:
        count += one.predicted > 0
    temper = numbers.temper * min(1.0, FULL_WEIGHT / max(count, 1))
    other = np.logaddexp(temper * (body - here) + numbers.body, temper * (shape - here))
    less = temper * (nothing - here) + numbers.nothing
    return other, less, temper * ahead - numbers.nothing


@compiled
def judge(lenses, labels, pictures, used, box, place, stands, seen, numbers):  # type: ignore[no-untyped-def]
    """Count what label maps show of an object, and return the evidence for it: see `evidence_of`.

    Label maps and place (rotation, position, lags) are as in `count_labels`, which fills seen (C,) of SEEN.
    In images without which the pose was found (left out of `used` (C,) of PICTURE), colours beside the object
    count as seen elsewhere: a noisy or flooded image shows them everywhere.
    """
    rotation, position, lags = place
    count_labels(lenses, labels, pictures, box, rotation, position, lags, seen)
    for c in range(len(seen)):
        if pictures[c].used and not used[c].used:
            seen[c].elsewhere, seen[c].extra = seen[c].elsewhere + seen[c].extra, 0
    return evidence_of(seen, box[1], stands, numbers)
