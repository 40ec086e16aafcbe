"""Draw docs/overlay.webp: three seconds of the simulated platform with the estimated pose.

    python scripts/draw_moving_picture.py [FILM]

FILM is the overlay.mp4 of `make demo`; without one, the demo is run first.
"""

import subprocess
import sys
import tempfile
from pathlib import Path

import av
from PIL import Image

ROOT = Path(__file__).resolve().parents[1]
FRAMES, RATE, WIDTH = 30, 10, 720


def draw(film: Path, picture: Path) -> None:
    """Write the film's first frames as an animated WebP."""
    with av.open(str(film)) as container:
        images = [
            frame.to_image() for _, frame in zip(range(FRAMES), container.decode(video=0), strict=False)
        ]
    size = WIDTH, round(WIDTH * images[0].height / images[0].width)
    first, *others = (image.resize(size, Image.Resampling.LANCZOS) for image in images)
    first.save(picture, save_all=True, append_images=others, duration=1000 // RATE, loop=0, quality=80)


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as folder:
        film = Path(sys.argv[1]) if len(sys.argv) > 1 else Path(folder) / "overlay.mp4"
        if len(sys.argv) == 1:
            demo = [sys.executable, str(ROOT / "examples" / "demo.py"), "--frames", str(FRAMES)]
            subprocess.run([*demo, "--output", folder], check=True)
        draw(film, ROOT / "docs" / "overlay.webp")
