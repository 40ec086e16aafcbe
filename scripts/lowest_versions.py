"""Print, as requirements for pip, the lowest versions that pyproject.toml allows: `name==version` per line.

    python scripts/lowest_versions.py [--python VERSION] [EXTRA ...]

They are those of the project itself, of the named extras, and of the packages that run the tests.
"""

import argparse
import sys
from collections.abc import Iterator
from pathlib import Path

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from packaging.version import Version

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

PROJECT = Path(__file__).resolve().parents[1] / "pyproject.toml"
RUNNERS = ("pytest", "hypothesis", "pytest-xdist", "pytest-timeout")
"""Packages of the extra `dev` that run tests; the others check the code."""


def requirements(*extras: str, python: str) -> Iterator[Requirement]:
    """Yield what the project and some of its extras require on a Python version, such as "3.10".

    Raises:
        KeyError: an extra does not exist.
    """
    project = tomllib.loads(PROJECT.read_text(encoding="utf-8"))["project"]
    lists = [project["dependencies"], *(project["optional-dependencies"][extra] for extra in extras)]
    for requirement in map(Requirement, [one for some in lists for one in some]):
        if requirement.marker is not None and not requirement.marker.evaluate({"python_version": python}):
            continue
        if requirement.name == project["name"]:
            yield from requirements(*sorted(requirement.extras), python=python)
        else:
            yield requirement


def lowest(requirement: Requirement) -> Version:
    """Return the lowest version that a requirement allows.

    Raises:
        ValueError: it states no lowest version.
    """
    found = [one.version for one in requirement.specifier if one.operator in (">=", "==")]
    if len(found) != 1:
        raise ValueError(f"{requirement}: found no lowest version, expected one (>= or ==)")
    return Version(found[0])


def main() -> None:
    """Print the requirements."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("extras", nargs="*", metavar="EXTRA", help="an extra of the project")
    this = "{}.{}".format(*sys.version_info)
    parser.add_argument("--python", default=this, metavar="VERSION", help="default: this one")
    arguments = parser.parse_args()
    runners = [one for one in requirements("dev", python=arguments.python) if one.name in RUNNERS]
    needed = [*requirements(*arguments.extras, python=arguments.python), *runners]
    versions: dict[str, Version] = {}
    for one in needed:
        name = canonicalize_name(one.name)
        versions[name] = max(lowest(one), versions.get(name, lowest(one)))
    for name, version in sorted(versions.items()):
        print(f"{name}=={version}")


if __name__ == "__main__":
    main()
