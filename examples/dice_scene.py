"""Make the example of the dice task in `examples/dice`: images, calibration, a goal not yet reached."""

from pathlib import Path

import numpy as np

from synthetic.camera.rigs import sized, standard_rig
from synthetic.frames import frames
from tracker import viz
from tracker.tasks import rearrange_dice

FOLDER = Path(__file__).with_name("dice")
SEED, ELSEWHERE = 17, 5


def main() -> None:
    """Place dice on cells of the task's grid; the goal has a few of them elsewhere."""
    FOLDER.mkdir(exist_ok=True)
    rig = sized(standard_rig(), 270)
    rig.save(FOLDER)
    (frame,) = frames("dice", 1, SEED, rig=rig, kind="dice_goal", empty=0.0)
    for name, image in zip(rig.names, frame.images, strict=True):
        viz.write_image(FOLDER / f"{name}.png", image)
    cells = rearrange_dice.cells()
    places = np.array([state.position for state in frame.objects])
    cell = np.array([int(np.argmin(np.linalg.norm(cells - place, axis=1))) for place in places])
    rng = np.random.default_rng(SEED)
    free = np.setdiff1d(np.arange(len(cells)), cell)
    cell[rng.choice(len(cell), ELSEWHERE, replace=False)] = rng.choice(free, ELSEWHERE, replace=False)
    rearrange_dice.write_goal(FOLDER / "goal.json", cells[cell])
    rearrange_dice.write_goal(FOLDER / "goal.txt", cells[cell])


if __name__ == "__main__":
    main()
