"""The model of the tracker's errors: its file, its plot, and its comparison with films outside the fit."""

from __future__ import annotations

import dataclasses
import time
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from benchmarks.data.plan import Plan
from benchmarks.measure.noise import measure_noise
from benchmarks.score.noise import FITTED, Values, agreement, fit, simulated, to_toml
from tracker.conventions import Array
from tracker.files import write_whole
from tracker.noise import NoiseModel

IMAGES = 0.036
"""Delay from the exposure to the tracker [s]: the 90 ms assumed by the platform's simulation, less the time
that its tracker takes."""


def measured(name: str, plan: Plan, check: int, output: Path, *, refined: bool) -> str:
    """Fit a model to the plan's films, write it, and compare it with films of the seed `check`.

    Returns:
        The table of the comparison, with the processor time of a step.
    """
    episodes, films, spent = measure_noise(name, plan, refined=refined)
    start: Values = {
        group: {key: pair[part] for key, pair in FITTED.items()}
        for part, group in enumerate(("position", "rotation"))
    }
    logs = np.log(spent)
    delay = {"images": IMAGES, "pose": float(np.exp(np.median(logs))), "spread": float(logs.std())}
    found = fit(episodes, films, start | {"delay": delay})
    ends = np.array([np.quantile(np.reshape(logs, (-1, 60)).mean(axis=1), q) for q in (0.025, 0.975)])
    found["delay"] = {
        "images": (IMAGES, []),
        "pose": (delay["pose"], sorted([*np.exp(ends), delay["pose"]])[::2]),
        "spread": (delay["spread"], [0.9 * delay["spread"], 1.1 * delay["spread"]]),
    }
    cameras = "off by 0.16 mm and 0.02° only, as a refinement leaves them" if refined else "as calibrated"
    about = (
        f"This tracker: poses that update measures on rendered films of {name} with all effects and covers, "
        f"three cameras of 270 x 270 at 10 Hz, cameras {cameras}; written by python -m benchmarks noise"
    )
    write_whole(output, to_toml(about, found))
    fresh = np.stack(measure_noise(name, dataclasses.replace(plan, seed=check), refined=refined)[0])
    model = NoiseModel.load(output)
    values = {
        group: {key: number.value for key, number in numbers.items()}
        for group, numbers in model.numbers.items()
    }
    modelled = simulated(values, list(fresh), seed=5)
    write_plot(fresh, modelled, output.with_suffix(".png"))
    lines = [f"{'':34s} measured   model  differ by"]
    for what, one, other in agreement(fresh, modelled):
        lines.append(f"{what:34s} {one:8.3f} {other:7.3f} {100 * (other / one - 1):8.1f} %")
    return "\n".join([*lines, f"a step of 4096 environments: {step_time(model):.2f} ms of processor time"])


def step_time(model: NoiseModel, count: int = 4096) -> float:
    """Return the median processor time of one step of `count` environments [ms]."""
    rng = np.random.default_rng(0)
    state = model.start(rng, count)
    truth = rng.normal(size=(count, 3)), rng.normal(size=(count, 4)), rng.uniform(0.3, 1.0, count)
    spent = []
    for _ in range(200):
        begin = time.process_time()
        state.step(*truth, 0.1)
        spent.append(time.process_time() - begin)
    return 1e3 * float(np.median(spent))


def write_plot(measured_: Array, modelled: Array, target: Path) -> None:
    """Plot the cumulative distributions of error sizes in films and in the model."""
    figure = Figure(figsize=(9, 3.2), dpi=100, layout="constrained")
    axes = figure.subplots(1, 2, sharey=True)
    for axis, columns, scale, unit in zip(
        axes, (slice(2, 5), slice(5, 8)), (1e3, 180 / np.pi), ("position [mm]", "rotation [°]"), strict=True
    ):
        for label, style, color, episodes in (
            ("films", "-", "#222222", measured_),
            ("model", "--", "#3366aa", modelled),
        ):
            size = scale * np.linalg.norm(episodes[..., columns], axis=2).ravel()
            size = np.sort(size[np.isfinite(size)])
            shares = np.arange(1, len(size) + 1) / len(size)
            axis.plot(size, 100 * shares, style, color=color, label=label)
        axis.set(xlabel=f"error of {unit}", xscale="log", xlim=(0.05, 10))
        axis.xaxis.set_major_formatter("{x:g}")
        axis.spines[["top", "right"]].set_visible(False)
    axes[0].set_ylabel("errors below [%]")
    axes[0].legend(frameon=False)
    figure.savefig(target)
