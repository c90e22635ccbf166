"""The oldest version of each dependency that pyproject.toml allows, printed as constraints for pip."""

import tomllib
from pathlib import Path

project = tomllib.loads((Path(__file__).parents[2] / "pyproject.toml").read_text(encoding="utf-8"))["project"]
for requirement in project["dependencies"] + project["optional-dependencies"]["test"]:
    name, oldest = requirement.split(">=")
    print(f"{name}=={oldest}")
