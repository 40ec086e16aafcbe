"""What `tracker colors check` says beside the overlaps: confusions, weak faces, colours that are near."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import click

from tracker.cli.table import table

if TYPE_CHECKING:
    from tracker.conventions import Array, FloatArray
    from tracker.segmentation.separation import Paints

WEAK = 0.9
"""Share of a colour's pixels that are found below which it is weak."""

FALSE = 0.1
"""Share of the pixels found in a colour that are of no such face above which it is weak, too."""


def print_report(counts: Array, paints: Paints) -> None:
    """Print what a confusion (7, 7) and the faces' colours tell."""
    _print_confusion(counts)
    _print_weak(counts)
    _print_near(paints)


def _print_confusion(counts: Array) -> None:
    from tracker.objects.labels import COLOR_NAMES

    rows = [["of the pixels of", *COLOR_NAMES[1:], "none"]]
    for label in [*range(1, len(COLOR_NAMES)), 0]:
        row = counts[label]
        if not row.sum():
            continue
        shares = [*row[1:], row[0]] / row.sum()
        rows.append([COLOR_NAMES[label], *(f"{share:.2%}" if share else "-" for share in shares)])
    click.echo(f"\nfound as\n{table(rows)}")


def _print_weak(counts: Array) -> None:
    """Colours whose pixels are not found, or whose name others get."""
    from tracker.objects.labels import COLOR_NAMES

    click.echo()
    weak = False
    for label in range(1, len(COLOR_NAMES)):
        row, column = counts[label].astype(float), counts[:, label].astype(float)
        if not row.sum():
            continue
        found = row[label] / row.sum()
        if found < WEAK:
            row[label] = 0
            taken = COLOR_NAMES[int(row.argmax())]
            click.echo(
                f"weak: {COLOR_NAMES[label]}, of which {found:.0%} is found; most of the rest as {taken}"
            )
            weak = True
        false = 1 - column[label] / column.sum() if column.sum() else 0.0
        if false > FALSE:
            column[label] = 0
            of = COLOR_NAMES[int(column.argmax())]
            click.echo(f"weak: {COLOR_NAMES[label]}; {false:.0%} of what is found as it is none, mostly {of}")
            weak = True
    if not weak:
        click.echo("no colour is weak")


def _print_near(paints: Paints) -> None:
    """How far apart the colours are, and which would be farther."""
    from tracker.objects.labels import COLOR_NAMES
    from tracker.segmentation.separation import LIGHT, NEAR, better_set, distances

    means = paints.means()
    far = distances(means)
    rows = [["distance to", *(COLOR_NAMES[label] for label in means), "the light"]]
    for a in means:
        cells = [f"{far[min(a, b), max(a, b)]:.1f}" if a != b else "-" for b in means]
        rows.append([COLOR_NAMES[a], *cells, f"{far[LIGHT, a]:.1f}"])
    blue, green, red = (100 * paints.light).round().astype(int).tolist()
    click.echo(f"\nin standard deviations of what light, shade and camera do to a colour\n{table(rows)}")
    click.echo(f"the light: red {red} %, green {green} %, blue {blue} %")
    for (a, b), value in sorted(far.items(), key=lambda item: item[1]):
        if value < NEAR:
            other = "the light, which is that of all that is grey" if a == LIGHT else COLOR_NAMES[a]
            click.echo(f"near: {COLOR_NAMES[b]} and {other}, {value:.1f}")
    better = better_set(means)
    gain = f"nearest {min(far.values()):.1f} -> {min(distances(better).values()):.1f}"
    click.echo(f"\na better set of colours, {gain}; red, green, blue where the picture's greys are at 115")
    click.echo(table(_set_rows(means, better)))


def _set_rows(means: Mapping[int, FloatArray], better: Mapping[int, FloatArray]) -> Sequence[Sequence[str]]:
    from tracker.objects.labels import COLOR_NAMES

    def told(color: FloatArray) -> str:
        return " ".join(f"{round(level):3d}" for level in color[::-1].tolist())

    rows = [["", "now", "better"]]
    for label, mean in means.items():
        same = bool((mean == better[label]).all())
        rows.append([COLOR_NAMES[label], told(mean), "stays" if same else told(better[label])])
    return rows
