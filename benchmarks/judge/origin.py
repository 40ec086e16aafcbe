"""Origin of results: the commit, the exact sources, the kernels compiled from them, and the machine."""

from __future__ import annotations

import hashlib
import platform
import subprocess
from pathlib import Path
from typing import Any

from benchmarks.data.fingerprint import PROJECT, ROOT, version_of
from synthetic.render.renderer import shared_renderer
from tracker import compiled

LIBRARIES = ("numpy", "scipy", "numba", "opencv-python-headless", "pybullet", "trimesh", "pyrender")

_OWN = ("gate.json", "published.json")
"""Files that the benchmarks write into their own folder."""


def origin() -> dict[str, Any]:
    """Return `commit`, whether the tree is `clean`, hashes of `code` and `kernels`, and the machine."""
    return {
        "commit": _git("rev-parse", "HEAD") or "unknown",
        "clean": not _git("status", "--porcelain", "--", *PROJECT),
        "code": code(),
        "kernels": compiled.fingerprint("tracker"),
        "processor": _processor(),
        "python": platform.python_version(),
        "libraries": {name: version_of(name) for name in LIBRARIES},
        "renderer": shared_renderer().name,
    }


def code() -> str:
    """Return a hash of all sources and their data, as they are on disk now."""
    digest = hashlib.sha256()
    for folder in PROJECT:
        for file in sorted((ROOT / folder).rglob("*")):
            counts = file.suffix != ".md" and file.name not in _OWN and "__pycache__" not in file.parts
            if counts and file.is_file():
                digest.update(str(file.relative_to(ROOT)).encode() + b"\0" + file.read_bytes())
    return digest.hexdigest()[:16]


def _git(*arguments: str) -> str:
    done = subprocess.run(["git", *arguments], cwd=ROOT, capture_output=True, text=True, check=False)
    return done.stdout.strip()


def _processor() -> str:
    info = Path("/proc/cpuinfo")
    lines = info.read_text().splitlines() if info.exists() else []
    names = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor()
